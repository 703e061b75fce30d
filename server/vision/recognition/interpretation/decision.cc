#include "server/vision/recognition/interpretation/decision.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "server/vision/recognition/learnt_constants.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr double kUnlikely = 0.4;  // no object is answered with less probability beside others

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

// What of the price an object pays that leads the runner-up in its place.
double PriceLeft(const JointContext& context, double evidence, double runner_up) {
  return std::max(0.0, PriceOfTrying(context.objects.size()) - std::max(0.0, evidence - runner_up));
}

}  // namespace

double ObjectProbability(const PlacedObject& p) {
  const double sharpness = p.total.Sharpness();
  return Logistic(kObjectPriorLogOdds + kObjectSupportWeight * (p.score - kChanceSupport) +
                  kObjectSharpnessWeight * (sharpness - kChanceSupport) +
                  std::max(0.0, TextureLogOdds(p.texture, sharpness)));
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
  double log_odds = kScenePriorLogOdds;
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

}  // namespace horopter
