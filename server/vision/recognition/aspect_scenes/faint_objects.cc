#include "server/vision/recognition/aspect_scenes/faint_objects.h"

#include <algorithm>
#include <utility>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr int kLeastViews = 3;           // two agree on a wrong surface, too
constexpr double kCredibleScore = 0.45;  // of the scene's best object
// Least score, correlation over the surface and ordered pairs of views it is of. Of what lies on a
// plane beside sure parts in scenes of six sets, scored .26 - .60, 61 of 67 right parts had .5 and
// more, and of wrong ones four turned poses of right parts. ADR 54.
constexpr double kLeastScore = 0.27;
constexpr double kLeastSurface = 0.5;
constexpr int kLeastPairs = 6;
// Of LiesOn's limits, where the views agree so much on the surface: a pose of few edges is less
// exact (right ones were 3.0 degrees, or 0.028 of the diameter, off).
constexpr double kSlack = 1.8;

bool ViewsAgreeOn(const LinkedObject& o) {
  return o.surface >= kLeastSurface && o.surface_pairs >= kLeastPairs;
}

}  // namespace

bool MayShowFaintObjects(const LinkedScene& scene) {
  return scene.registered() >= kLeastViews &&
         std::any_of(scene.objects.begin(), scene.objects.end(), [](const LinkedObject& o) {
           return o.score >= kCredibleScore;
         });
}

void AddFaintObjects(const AspectLinkInput& input,
                     const AspectLinkOptions& options,
                     const SceneObjects& objects,
                     std::vector<AspectSceneObject> candidates,
                     LinkedScene* linked) {
  if (!MayShowFaintObjects(*linked)) return;
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
  objects.FindLying(scene.views, &judged, kSlack);
  std::vector<LinkedObject> faint(judged.begin() + static_cast<std::ptrdiff_t>(known),
                                  judged.end());
  std::erase_if(faint, [](const LinkedObject& o) { return !o.lies || o.score < kLeastScore; });
  std::stable_sort(faint.begin(), faint.end(), [](const LinkedObject& a, const LinkedObject& b) {
    return a.score > b.score;
  });
  linked->objects.insert(linked->objects.end(), faint.begin(), faint.end());
  objects.MeasureSurfaces(linked);
  for (std::size_t i = 0; i < known; ++i) {
    LinkedObject& o = linked->objects[i];
    o.lies = o.lies || (judged[i].lies && ViewsAgreeOn(o));
  }
  linked->objects.erase(std::remove_if(linked->objects.begin() + static_cast<std::ptrdiff_t>(known),
                                       linked->objects.end(),
                                       [](const LinkedObject& o) { return !ViewsAgreeOn(o); }),
                        linked->objects.end());
}

}  // namespace horopter
