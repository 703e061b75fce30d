#include "server/vision/recognition/interpretation/aspect_answer.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "server/vision/recognition/interpretation/log_odds.h"

namespace horopter {
namespace {

// Largest angle (radians) under which two views see one of the objects.
double Parallax(const LinkedScene& scene,
                std::span<const std::shared_ptr<const PreparedObject>> objects) {
  double least = 1.0;
  for (const LinkedObject& o : scene.objects) {
    const Eigen::Vector3d center = o.scene_from_object * objects[o.object]->center;
    std::vector<Eigen::Vector3d> rays;
    for (const auto& view : scene.views) {
      if (!view) continue;
      rays.push_back((center - view->camera_from_scene.Inverse().t).normalized());
      for (const Eigen::Vector3d& other : rays) least = std::min(least, other.dot(rays.back()));
    }
  }
  return std::acos(std::clamp(least, -1.0, 1.0));
}

SceneObject ToAnswer(const LinkedObject& o, double probability) {
  SceneObject out;
  out.object = o.object;
  out.scene_from_object = o.scene_from_object;
  out.score = probability;
  out.support = o.score;
  out.view_scores = ViewScores(o);
  return out;
}

std::vector<std::optional<CalibratedCamera>> RecognizedViews(const LinkedScene& scene) {
  std::vector<std::optional<CalibratedCamera>> out(scene.views.size());
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (scene.views[v])
      out[v] = CalibratedCamera{scene.views[v]->camera, scene.views[v]->camera_from_scene};
  }
  return out;
}

// Notes the placements of the logged object whose value is below what is needed.
template <typename ValueOf>
void NoteBelow(const LinkedScene& scene,
               AcceptanceTest test,
               double needed,
               const ValueOf& value_of,
               RefusalLog* log) {
  if (log == nullptr) return;
  for (const LinkedObject& o : scene.objects) {
    if (o.object != log->object || value_of(o) >= needed) continue;
    log->refusals.push_back(
        {test, o.scene_from_object, RecognizedViews(scene), value_of(o), needed});
  }
}

}  // namespace

std::vector<double> ViewScores(const LinkedObject& o) {
  std::vector<double> out;
  for (std::size_t v = 0; v < o.views.size(); ++v)
    out.push_back(o.shown[v] ? o.views[v].score : -1.0);
  return out;
}

void AddAlternative(int object, SceneObject* answer, RecognitionResult* result) {
  if (result->state == RecognitionState::kRecognized) result->state = RecognitionState::kAmbiguous;
  if (std::find(answer->alternatives.begin(), answer->alternatives.end(), object) ==
      answer->alternatives.end())
    answer->alternatives.push_back(object);
}

void Tell(const std::string& sentence, RecognitionResult* result) {
  absl::StrAppend(&result->detail, result->detail.empty() ? "" : ". ", sentence);
}

void AddAnswer(const LinkedObject& o,
               double probability,
               double ambiguity_gap,
               RecognitionResult* result) {
  SceneObject answer = ToAnswer(o, probability);
  if (o.competing_object >= 0 && o.competing_score > o.score - ambiguity_gap)
    AddAlternative(o.competing_object, &answer, result);
  result->objects.push_back(std::move(answer));
}

RecognitionResult ToResult(const JointContext& context,
                           const LinkedScene& scene,
                           RefusalLog* log,
                           bool with_cameras) {
  const AspectAcceptance& options = context.options.acceptance.aspects;
  const SceneAcceptance& of_scenes = context.options.acceptance.scene;
  const auto views = RecognizedViews(scene);
  const double least = options.min_probability;
  const auto probability = [&](const LinkedObject& o) {
    return WithUnknownShare(
        with_cameras ? ProbabilityUnderCameras(o, scene) : AspectProbability(o, scene, options),
        context.options.unknown_share);
  };
  RecognitionResult result;
  result.views.resize(scene.views.size());
  for (const LinkedObject& o : scene.objects)
    result.verified.push_back(ToAnswer(o, probability(o)));
  LinkedScene accepted = scene;
  NoteBelow(scene, AcceptanceTest::kChance, least, probability, log);
  std::erase_if(accepted.objects, [&](const LinkedObject& o) { return probability(o) < least; });
  if (accepted.objects.empty()) {
    if (!scene.objects.empty()) {
      const LinkedObject& best = scene.objects.front();
      result.detail =
          absl::StrFormat("%s fits best with %.2f of its edges' score, but so may chance",
                          context.objects[best.object]->model.id,
                          best.score);
    }
    return result;
  }
  const double parallax = Parallax(accepted, context.objects);
  if (scene.registered() > 1 && parallax < of_scenes.min_parallax_rad) {
    constexpr double kDegrees = 180.0 / std::numbers::pi;
    result.state = RecognitionState::kNoParallax;
    NoteBelow(
        accepted,
        AcceptanceTest::kParallax,
        of_scenes.min_parallax_rad,
        [&](const LinkedObject&) { return parallax; },
        log);
    result.detail = absl::StrFormat("the views see the objects within %.1f degrees, need %.1f",
                                    kDegrees * parallax,
                                    kDegrees * of_scenes.min_parallax_rad);
    return result;
  }
  result.route = RecognitionRoute::kAspects;
  result.state = RecognitionState::kRecognized;
  result.views = RecognizedViews(scene);
  for (const LinkedObject& o : accepted.objects) {
    AddAnswer(o, probability(o), of_scenes.ambiguity_gap, &result);
  }
  return result;
}

}  // namespace horopter
