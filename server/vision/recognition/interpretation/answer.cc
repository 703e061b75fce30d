#include "server/vision/recognition/interpretation/answer.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "absl/strings/str_format.h"
#include "server/vision/recognition/interpretation/decision.h"

namespace horopter {
namespace {

SceneObject ToObject(const SceneModel& scene, const PlacedObject& p) {
  SceneObject o;
  o.object = p.object;
  o.scene_from_object = p.scene_from_object;
  o.support = p.score;
  for (std::size_t v = 0; v < p.support.size(); ++v) {
    const bool seen = scene.views[v] && p.support[v].visible > 0;
    o.view_scores.push_back(seen ? ViewScore(p.support[v]) : -1.0);
  }
  return o;
}

}  // namespace

double LargestParallax(const JointContext& context, const SceneModel& scene) {
  double smallest_cosine = 1.0;
  for (const PlacedObject& o : scene.objects) {
    const Eigen::Vector3d center = o.scene_from_object * context.objects[o.object]->center;
    std::vector<Eigen::Vector3d> rays;
    for (const auto& view : scene.views) {
      if (!view) continue;
      rays.push_back((center - view->camera_from_scene.Inverse().t).normalized());
      for (const Eigen::Vector3d& other : rays)
        smallest_cosine = std::min(smallest_cosine, other.dot(rays.back()));
    }
  }
  return std::acos(std::clamp(smallest_cosine, -1.0, 1.0));
}

RecognitionResult MakeResult(const JointContext& context,
                             const SceneModel& scene,
                             std::span<const PlacedObject> verified,
                             std::span<const double> best_competing,
                             std::span<const Alternative> alternatives,
                             bool trusted) {
  const SceneAcceptance& acceptance = context.options.acceptance.scene;
  RecognitionResult result;
  result.views = scene.views;
  for (const PlacedObject& p : verified) result.verified.push_back(ToObject(scene, p));
  if (scene.objects.empty()) return result;

  const double parallax = LargestParallax(context, scene);
  if (scene.registered() > 1 && parallax < acceptance.min_parallax_rad) {
    constexpr double kDegrees = 180.0 / std::numbers::pi;
    result.state = RecognitionState::kNoParallax;
    result.detail = absl::StrFormat("the views see the objects within %.1f degrees, need %.1f",
                                    kDegrees * parallax,
                                    kDegrees * acceptance.min_parallax_rad);
    result.views.assign(scene.views.size(), std::nullopt);
    return result;
  }
  result.state = RecognitionState::kRecognized;
  const double probability = SceneProbability(context, scene, best_competing);
  for (const PlacedObject& p : scene.objects) {
    result.objects.push_back(ToObject(scene, p));
    result.objects.back().score = probability * ObjectProbability(p);
  }
  for (const Alternative& alternative : alternatives) {
    SceneObject& accepted = result.objects[alternative.accepted];
    const bool itself = alternative.placed.object == accepted.object;
    const double gap =
        itself && !trusted ? acceptance.loose_ambiguity_gap : acceptance.ambiguity_gap;
    if (alternative.score < accepted.support - gap) continue;
    result.state = RecognitionState::kAmbiguous;
    std::vector<int>& listed = accepted.alternatives;
    if (std::find(listed.begin(), listed.end(), alternative.placed.object) != listed.end()) {
      continue;
    }
    listed.push_back(alternative.placed.object);
    if (itself) {
      absl::StrAppendFormat(&result.detail,
                            "%s%s scores %.2f in another pose, %.2f in this one",
                            result.detail.empty() ? "" : "; ",
                            context.objects[accepted.object]->model.id,
                            alternative.score,
                            accepted.support);
    }
  }
  return result;
}

}  // namespace horopter
