#include "server/vision/recognition/aspect_scenes/doubtful_views.h"

#include <algorithm>

#include "server/vision/recognition/aspect_scenes/hypothesis_support.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"

namespace horopter {
namespace {

constexpr double kDoubtfulShare = 0.5;  // of what the middle view shows: looked at again
constexpr double kBetterScore = 0.06;   // of another pose of an object in one view

// Whether the view has a hypothesis of an object, in its place but elsewhere in pose, that explains
// more.
bool IsContradicted(const LinkedScene& scene,
                    std::span<const AspectModel> models,
                    const ViewLinks& links,
                    int v) {
  const AspectSceneView& view = *scene.views[v];
  for (const LinkedObject& o : scene.objects) {
    if (!o.shown[v]) continue;
    const Rigid3 expected = view.camera_from_scene * o.scene_from_object;
    const RenderMesh& mesh = models[o.object].object->mesh;
    const Eigen::Vector3d center = mesh.center.cast<double>();
    const double size = SizePx(models[o.object], view.camera, expected);
    for (const AspectHypothesis& h : links.Hypotheses(v)) {
      if (h.object != o.object || h.score < o.views[v].score + kBetterScore) continue;
      const Eigen::Vector2d there = Project(h.camera, h.camera_from_object * center);
      if ((Project(view.camera, expected * center) - there).norm() > 0.5 * size) continue;
      const double off =
          PoseDistancePx(models[h.object], view.camera, expected, h.camera, h.camera_from_object);
      if (off > kOtherPoseShare * size) return true;
    }
  }
  return false;
}

// Views that show less than `share` of what the middle view shows of the objects.
std::vector<bool> PoorInScore(const LinkedScene& scene, double share) {
  std::vector<bool> poor(scene.views.size(), false);
  if (scene.registered() < 3) return poor;
  std::vector<double> shows;
  std::vector<double> of_view(scene.views.size(), 0.0);
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    for (const LinkedObject& o : scene.objects)
      of_view[v] += o.shown[v] ? std::max(0.0, o.views[v].score - kLeastChance) : 0.0;
    shows.push_back(of_view[v]);
  }
  const auto middle = shows.begin() + static_cast<std::ptrdiff_t>(shows.size() / 2);
  std::nth_element(shows.begin(), middle, shows.end());
  for (std::size_t v = 0; v < scene.views.size(); ++v)
    poor[v] = scene.views[v].has_value() && of_view[v] < share * *middle;
  return poor;
}

}  // namespace

std::vector<bool> PoorViews(const LinkedScene& scene, double share) {
  std::vector<bool> poor = PoorInScore(scene, share);
  if (scene.registered() < 3) return poor;
  for (std::size_t v = 0; v < scene.views.size(); ++v)
    poor[v] = poor[v] || (scene.views[v] && scene.agreement.IsOdd(static_cast<int>(v)));
  return poor;
}

LinkedScene WithoutDoubtfulViews(const LinkedScene& scene,
                                 std::span<const AspectModel> models,
                                 const ViewLinks& links) {
  LinkedScene out = scene;
  const std::vector<bool> poor = PoorViews(scene, kDoubtfulShare);
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v] || out.registered() < 3) continue;
    if (poor[v] || IsContradicted(scene, models, links, static_cast<int>(v))) out.views[v].reset();
  }
  return out;
}

}  // namespace horopter
