#include "server/vision/recognition/aspect_scenes/standing_candidates.h"

#include "server/vision/recognition/aspect_scenes/standing_search.h"

namespace horopter {

std::vector<AspectSceneObject> FreeStanding(const AspectLinkInput& input,
                                            const AspectLinkOptions& options,
                                            const SceneObjects& objects,
                                            std::span<const StandingPlane> planes,
                                            const AspectScene& scene,
                                            int most,
                                            const StopRequested& stop) {
  StandingSearchOptions search = options.standing_search;
  search.threads = options.threads;
  std::vector<AspectSceneObject> candidates;
  for (const StandingPlane& plane : planes) {
    int of_plane = 0;
    for (const StandingCandidate& c : FindStanding(
             input.images, scene.views, input.models, plane, scene.objects, search, stop)) {
      if (of_plane >= most) break;
      if (!objects.IsFree(scene.views, scene.objects, c.placed)) continue;
      candidates.push_back(c.placed);
      ++of_plane;
    }
  }
  return candidates;
}

}  // namespace horopter
