#include "server/vision/recognition/aspect_scenes/faint_objects.h"

#include <algorithm>
#include <span>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/settled_scenes.h"

namespace horopter {
namespace {

constexpr int kLeastViews = 3;  // two agree on a wrong surface, too
// Least score, correlation over the surface and ordered pairs of views it is of. Of what lies on a
// plane beside sure parts in scenes of six sets, scored .26 - .60, 61 of 67 right parts had .5 and
// more, and of wrong ones four turned poses of right parts. ADR 54.
constexpr double kLeastScore = 0.27;
constexpr double kLeastSurface = 0.5;
constexpr int kLeastPairs = 6;
// Of LiesOn's limits, where the views agree so much on the surface: a pose of few edges is less
// exact (right ones were 3.0 degrees, or 0.028 of the diameter, off).
constexpr double kSlack = 1.8;
constexpr std::size_t kRivals = 4;  // other poses of a placed object that are looked at; chosen

// The object as it was placed, and the best candidates of the same part in its place: quickly
// rendered, a few pixels of what others leave to see decide between its turns.
std::vector<AspectSceneObject> InPlaceOf(const AspectSceneObject& o,
                                         const AspectLinkInput& input,
                                         std::span<const AspectSceneObject> candidates) {
  const RenderMesh& mesh = input.models[o.object].object->mesh;
  const auto center = [&](const AspectSceneObject& placed) {
    return Eigen::Vector3d(placed.scene_from_object * mesh.center.cast<double>());
  };
  std::vector<AspectSceneObject> out = {o};
  for (const AspectSceneObject& c : candidates) {
    if (out.size() > kRivals) break;
    if (c.object == o.object && (center(c) - center(o)).norm() < kSamePlaceShare * mesh.diameter_m)
      out.push_back(c);
  }
  return out;
}

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
  objects.Place(candidates, options.min_quick - kClearly, &scene);
  const SceneLayers hiding = objects.HidingLayers(*linked);
  std::vector<const std::vector<ObjectLayer>*> others;
  for (const std::vector<ObjectLayer>& layers : hiding) others.push_back(&layers);
  ParallelFor(static_cast<int>(scene.objects.size() - known), options.threads, [&](int i) {
    AspectSceneObject& o = scene.objects[known + i];
    double best = 0.0;
    for (const AspectSceneObject& c : InPlaceOf(o, input, candidates)) {
      const RenderMesh& mesh = input.models[c.object].object->mesh;
      auto settled = SettleInViews(input.images, mesh, scene.views, c, kFineRenderPx, 0.0, others);
      if (!settled) continue;
      SceneJudgementOptions judging;
      judging.render_px = kFineRenderPx;
      const double score =
          JudgeInViews(
              input.images, mesh, scene.views, settled->placed, judging, others, settled->rendered)
              .score;
      if (score <= best) continue;
      best = score;
      o = settled->placed;
    }
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
