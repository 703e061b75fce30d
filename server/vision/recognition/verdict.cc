#include "server/vision/recognition/verdict.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "absl/strings/str_format.h"

namespace horopter {
namespace {

// Of the logistic regression: price of the adapted cameras and weights of what exceeds the origin.
constexpr double kPrice = 7.5;
constexpr double kSupportWeight = 20.0;
constexpr double kSharpnessWeight = 9.0;
constexpr double kOrigin = 0.55;
// Of one object in right cameras: logistic regression on parts-train and on scenes of other parts,
// 368 answered objects, 16 of them wrong, mostly with one of the scene's parts left out of the
// catalog (tests/bench/results.md).
constexpr double kObjectBase = 0.9;
constexpr double kObjectWeight = 9.3;
constexpr double kObjectSharpness = 11.0;
constexpr double kUnlikely = 0.4;  // no object is answered with less beside others
// Weight of texture for an object among the log odds, by hand: 40 - 62 patches alike and few unlike
// on right printed parts in photographs, at most 34 with 24 unlike on wrong ones.
constexpr double kTextureFor = 1.6;
// Texture shows that faces lie about where the part has them, in cameras that may have adapted;
// that it is this part its edges must say. Less sharp than by chance by this much: it says nothing
// more.
constexpr double kBluntness = 0.1;
constexpr double kSamePlaceVolume = 0.3;  // shared by placements in one place
constexpr double kLearntCatalog = 20.0;   // objects in the catalog that it was learnt with

double Logistic(double log_odds) {
  return 1.0 / (1.0 + std::exp(-log_odds));
}

bool FocalContradicted(const JointContext& context, const SceneModel& scene) {
  constexpr double kDeviations = 4.0;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const double off =
        std::log(scene.views[v]->camera.focal_px / context.start_cameras[v].focal_px);
    if (std::abs(off) > kDeviations * context.focal_log_sigma[v]) return true;
  }
  return false;
}

// What the texture on its faces adds to the log odds of an object.
double TextureOf(const PlacedObject& p) {
  if (p.texture <= 0.0) return p.texture;
  return kTextureFor * p.texture *
         std::clamp(1.0 - (kOrigin - p.total.Sharpness()) / kBluntness, 0.0, 1.0);
}

// That an object is right in cameras that are.
double ObjectProbability(const PlacedObject& p) {
  return Logistic(kObjectBase + kObjectWeight * (p.score - kOrigin) +
                  kObjectSharpness * (p.total.Sharpness() - kOrigin) + std::max(0.0, TextureOf(p)));
}

// What of the price an object pays that leads the runner-up in its place.
double PriceLeft(const JointContext& context, double evidence, double runner_up) {
  return std::max(0.0, PriceOfTrying(context.objects.size()) - std::max(0.0, evidence - runner_up));
}

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

double Evidence(double support, double sharpness) {
  return std::max(0.0,
                  kSupportWeight * (support - kOrigin) + kSharpnessWeight * (sharpness - kOrigin));
}

double EvidenceOf(const PlacedObject& p) {
  return Evidence(p.score, p.total.Sharpness()) + TextureOf(p);
}

double PriceOfTrying(std::size_t objects) {
  return std::max(0.0, std::log(static_cast<double>(objects) / kLearntCatalog));
}

std::vector<double> RunnersUp(const JointContext& context,
                              const SceneModel& scene,
                              std::span<const PlacedObject> placements,
                              std::span<const Rival> rivals) {
  std::vector<double> out(scene.objects.size(), 0.0);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const PlacedObject& held = scene.objects[i];
    for (const PlacedObject& p : placements) {
      const double evidence = EvidenceOf(p);
      if (p.object == held.object || evidence <= out[i]) continue;
      if (SharedVolume(*context.objects[held.object],
                       held.scene_from_object,
                       *context.objects[p.object],
                       p.scene_from_object) > kSamePlaceVolume) {
        out[i] = evidence;
      }
    }
  }
  for (const Rival& r : rivals) {
    if (r.placed.object == scene.objects[r.accepted].object) continue;
    out[r.accepted] = std::max(out[r.accepted], EvidenceOf(r.placed));
  }
  return out;
}

void DropChanceObjects(const JointContext& context,
                       std::span<const PlacedObject> placements,
                       SceneModel* scene) {
  const std::vector<double> runners_up = RunnersUp(context, *scene, placements);
  std::vector<PlacedObject> kept;
  for (std::size_t i = 0; i < scene->objects.size(); ++i) {
    PlacedObject& placed = scene->objects[i];
    const double evidence = EvidenceOf(placed), price = PriceLeft(context, evidence, runners_up[i]);
    if (price > 0.0 && evidence <= price) {
      scene->gain -= std::max(0.0, placed.gain);
    } else {
      kept.push_back(std::move(placed));
    }
  }
  scene->objects = std::move(kept);
}

double SceneLogOdds(const JointContext& context,
                    const SceneModel& scene,
                    std::span<const double> runners_up) {
  double log_odds = -kPrice;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const double evidence = EvidenceOf(scene.objects[i]);
    const double price =
        PriceLeft(context, evidence, runners_up.empty() ? evidence : runners_up[i]);
    // What speaks against an object is no matter of how many there are.
    log_odds += evidence - std::min(price, std::max(0.0, evidence));
  }
  return log_odds;
}

double SceneProbability(const JointContext& context,
                        const SceneModel& scene,
                        std::span<const double> runners_up) {
  return Logistic(SceneLogOdds(context, scene, runners_up));
}

std::string ReasonToDoubt(const JointContext& context,
                          const SceneModel& scene,
                          std::span<const double> runners_up) {
  if (scene.objects.empty()) return {};
  if (FocalContradicted(context, scene))
    return "the objects found contradict what is known of the focal lengths";
  const double probability = SceneProbability(context, scene, runners_up);
  if (probability >= context.options.accept_probability) return {};
  const PlacedObject& best = *std::max_element(
      scene.objects.begin(), scene.objects.end(), [](const auto& a, const auto& b) {
        return a.score < b.score;
      });
  return absl::StrFormat(
      "%d object(s) fit, best %s with support %.2f, but so may chance: probability %.2f, need %.2f",
      static_cast<int>(scene.objects.size()),
      context.objects[best.object]->model.id,
      best.score,
      probability,
      context.options.accept_probability);
}

void DropUnlikelyObjects(SceneModel* scene, std::vector<Rival>* rivals) {
  for (int k = static_cast<int>(scene->objects.size()) - 1; k >= 0; --k) {
    if (scene->objects.size() < 2 || ObjectProbability(scene->objects[k]) >= kUnlikely) continue;
    scene->objects.erase(scene->objects.begin() + k);
    std::erase_if(*rivals, [k](const Rival& r) { return r.accepted == k; });
    for (Rival& r : *rivals) r.accepted -= r.accepted > k;
  }
}

RecognitionResult MakeResult(const JointContext& context,
                             const SceneModel& scene,
                             std::span<const PlacedObject> verified,
                             std::span<const Rival> rivals,
                             bool trusted) {
  const RecognitionOptions& options = context.options;
  RecognitionResult result;
  result.views = scene.views;
  for (const PlacedObject& p : verified) result.verified.push_back(ToObject(scene, p));
  if (scene.objects.empty()) return result;

  const double parallax = LargestParallax(context, scene);
  if (scene.registered() > 1 && parallax < options.min_parallax_rad) {
    constexpr double kDegrees = 180.0 / std::numbers::pi;
    result.state = RecognitionState::kNoParallax;
    result.detail = absl::StrFormat("the views see the objects within %.1f degrees, need %.1f",
                                    kDegrees * parallax,
                                    kDegrees * options.min_parallax_rad);
    result.views.assign(scene.views.size(), std::nullopt);
    return result;
  }
  result.state = RecognitionState::kRecognized;
  const double probability =
      SceneProbability(context, scene, RunnersUp(context, scene, verified, rivals));
  for (const PlacedObject& p : scene.objects) {
    result.objects.push_back(ToObject(scene, p));
    result.objects.back().score = probability * ObjectProbability(p);
  }
  for (const Rival& rival : rivals) {
    SceneObject& accepted = result.objects[rival.accepted];
    const bool itself = rival.placed.object == accepted.object;
    const double gap = itself && !trusted ? options.loose_ambiguity_gap : options.ambiguity_gap;
    if (rival.score < accepted.support - gap) continue;
    result.state = RecognitionState::kAmbiguous;
    auto& alternatives = accepted.alternatives;
    if (std::find(alternatives.begin(), alternatives.end(), rival.placed.object) !=
        alternatives.end()) {
      continue;
    }
    alternatives.push_back(rival.placed.object);
    if (itself) {
      absl::StrAppendFormat(&result.detail,
                            "%s%s scores %.2f in another pose, %.2f in this one",
                            result.detail.empty() ? "" : "; ",
                            context.objects[accepted.object]->model.id,
                            rival.score,
                            accepted.support);
    }
  }
  return result;
}

}  // namespace horopter
