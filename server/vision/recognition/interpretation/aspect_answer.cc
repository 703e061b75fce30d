#include "server/vision/recognition/interpretation/aspect_answer.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"

namespace horopter {
namespace {

constexpr double kNearM = 1e-3;  // least depth that a size in the image is taken of

// The other route's object in this place of the images, -1: none.
int KnownInPlace(const JointContext& context,
                 const std::vector<std::optional<CalibratedCamera>>& views,
                 int object_index,
                 const Rigid3& scene_from_object,
                 const RecognitionResult& known) {
  const PreparedObject& object = *context.objects[object_index];
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || !known.views[v]) continue;
    const auto seen = [&](const CalibratedCamera& view, const Rigid3& pose) {
      return Project(view.camera, view.camera_from_scene * pose * object.center);
    };
    const double depth = (views[v]->camera_from_scene * scene_from_object * object.center).z();
    const double size =
        views[v]->camera.focal_px * object.model.diameter_m / std::max(depth, kNearM);
    const Eigen::Vector2d here = seen(*views[v], scene_from_object);
    for (std::size_t k = 0; k < known.objects.size(); ++k) {
      const SceneObject& other = known.objects[k];
      if (other.object == object_index &&
          (here - seen(*known.views[v], other.scene_from_object)).norm() <
              context.options.acceptance.aspects.same_place_share * size) {
        return static_cast<int>(k);
      }
    }
  }
  return -1;
}

// Of a scene that has at least half of what the other route found: its objects that got lost, in
// the frame of the others. What hides or prints cost them in these scores the table told.
void KeepKnown(const JointContext& context,
               const RecognitionResult& known,
               RecognitionResult* result) {
  std::vector<int> place(known.objects.size(), -1);  // of each known object in the result
  for (std::size_t i = 0; i < result->objects.size(); ++i) {
    SceneObject& o = result->objects[i];
    const int k = KnownInPlace(context, result->views, o.object, o.scene_from_object, known);
    if (k < 0 || place[k] >= 0) continue;
    place[k] = static_cast<int>(i);
  }
  const auto kept = std::find_if(place.begin(), place.end(), [](int p) { return p >= 0; });
  if (2 * std::count(place.begin(), place.end(), -1) > static_cast<std::ptrdiff_t>(place.size()) ||
      kept == place.end()) {
    return;
  }
  const Rigid3 here_from_known = result->objects[*kept].scene_from_object *
                                 known.objects[kept - place.begin()].scene_from_object.Inverse();
  for (std::size_t k = 0; k < place.size(); ++k) {
    if (place[k] >= 0) continue;
    SceneObject lost = known.objects[k];
    lost.scene_from_object = here_from_known * lost.scene_from_object;
    const auto center = [&](const SceneObject& o) {
      return Eigen::Vector3d(o.scene_from_object * context.objects[o.object]->center);
    };
    const bool taken =
        std::any_of(result->objects.begin(), result->objects.end(), [&](const SceneObject& o) {
          const double smaller = std::min(context.objects[o.object]->model.diameter_m,
                                          context.objects[lost.object]->model.diameter_m);
          return (center(o) - center(lost)).norm() <
                 context.options.acceptance.aspects.apart_share * smaller;
        });
    if (!taken) result->objects.push_back(std::move(lost));
  }
}

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

void AddAnswer(const LinkedObject& o,
               double probability,
               double ambiguity_gap,
               RecognitionResult* result) {
  SceneObject answer = ToAnswer(o, probability);
  if (o.competing_object >= 0 && o.competing_score > o.score - ambiguity_gap) {
    answer.alternatives.push_back(o.competing_object);
    result->state = RecognitionState::kAmbiguous;
  }
  result->objects.push_back(std::move(answer));
}

RecognitionResult ToResult(const JointContext& context,
                           const LinkedScene& scene,
                           const RecognitionResult* known,
                           RefusalLog* log,
                           bool with_cameras) {
  const AspectAcceptance& options = context.options.acceptance.aspects;
  const SceneAcceptance& of_scenes = context.options.acceptance.scene;
  const auto views = RecognizedViews(scene);
  const double least = with_cameras ? options.min_fitted_probability : NeededProbability(options);
  const auto probability = [&](const LinkedObject& o) {
    if (with_cameras) return ProbabilityUnderCameras(o, scene);
    const int k =
        known == nullptr ? -1 : KnownInPlace(context, views, o.object, o.scene_from_object, *known);
    const double found = AspectProbability(o, scene, options);
    if (k < 0 || known->objects[k].score < options.min_probability) return found;
    // Another route answers it: that is enough.
    return std::max({found, known->objects[k].score, least});
  };
  RecognitionResult result;
  result.views.resize(scene.views.size());
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
  if (known != nullptr) KeepKnown(context, *known, &result);
  return result;
}

}  // namespace horopter
