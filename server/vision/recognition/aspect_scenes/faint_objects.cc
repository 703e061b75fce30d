#include "server/vision/recognition/aspect_scenes/faint_objects.h"

#include <algorithm>
#include <utility>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr int kLeastViews = 3;            // two agree on a wrong surface, too
constexpr double kCredibleScore = 0.45;   // of the scene's best object
constexpr double kFairPlaneScore = 0.38;  // of what others lie on, where none reaches kPlaneScore
// Least score, correlation over the surface and ordered pairs of views it is of. Of what lies on a
// plane so in scenes of five sets with a score of .26 and more no wrong part had .5. ADR 54.
constexpr double kLeastScore = 0.27;
constexpr double kLeastSurface = 0.5;
constexpr int kLeastPairs = 6;

}  // namespace

void AddFaintObjects(const AspectLinkInput& input,
                     const AspectLinkOptions& options,
                     const SceneObjects& objects,
                     std::vector<AspectSceneObject> candidates,
                     LinkedScene* linked) {
  if (linked->registered() < kLeastViews ||
      std::none_of(linked->objects.begin(), linked->objects.end(), [](const LinkedObject& o) {
        return o.score >= kCredibleScore;
      }))
    return;
  AspectScene scene = SceneOf(*linked);
  const std::size_t known = scene.objects.size();
  objects.Place(std::move(candidates), options.min_quick - kClearly, &scene);
  ParallelFor(static_cast<int>(scene.objects.size() - known), options.threads, [&](int i) {
    AspectSceneObject& o = scene.objects[known + i];
    if (const auto settled = SettleInViews(
            input.images, input.models[o.object].object->mesh, scene.views, o, kFineRenderPx))
      o = settled->placed;
  });
  std::vector<LinkedObject> judged = objects.Judge(scene, kFineRenderPx);
  const bool any_gives_planes = std::any_of(
      judged.begin(), judged.end(), [](const LinkedObject& o) { return o.score >= kPlaneScore; });
  objects.FindLying(scene.views, any_gives_planes ? kPlaneScore : kFairPlaneScore, &judged);
  LinkedScene more = *linked;
  for (std::size_t i = known; i < judged.size(); ++i) {
    if (judged[i].lies && judged[i].score >= kLeastScore) more.objects.push_back(judged[i]);
  }
  std::stable_sort(more.objects.begin() + static_cast<std::ptrdiff_t>(known),
                   more.objects.end(),
                   [](const LinkedObject& a, const LinkedObject& b) { return a.score > b.score; });
  objects.MeasureSurfaces(&more);
  for (std::size_t i = known; i < more.objects.size(); ++i) {
    const LinkedObject& o = more.objects[i];
    if (o.surface >= kLeastSurface && o.surface_pairs >= kLeastPairs) linked->objects.push_back(o);
  }
}

}  // namespace horopter
