#include "server/vision/recognition/interpretation/decision.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "server/vision/recognition/learnt_constants.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

bool FocalContradicted(const JointContext& context, const SceneModel& scene) {
  const double most = context.options.acceptance.scene.max_focal_deviations;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const double off =
        std::log(scene.views[v]->camera.focal_px / context.start_cameras[v].focal_px);
    if (std::abs(off) > most * context.focal_log_sigma[v]) return true;
  }
  return false;
}

// What of the penalty an object pays that leads the best competing placement in its place.
double PenaltyLeft(const JointContext& context, double evidence, double competing) {
  return std::max(
      0.0, MultipleTestingPenalty(context.objects.size()) - std::max(0.0, evidence - competing));
}

}  // namespace

double ObjectProbability(const PlacedObject& p) {
  const double sharpness = p.total.Sharpness();
  return Logistic(kObjectPriorLogOdds + kObjectSupportWeight * (p.score - kChanceSupport) +
                  kObjectSharpnessWeight * (sharpness - kChanceSupport) +
                  std::max(0.0, TextureLogOdds(p.texture, sharpness)));
}

std::vector<double> BestCompeting(const JointContext& context,
                                  const SceneModel& scene,
                                  std::span<const PlacedObject> placements,
                                  std::span<const Alternative> alternatives) {
  std::vector<double> out(scene.objects.size(), 0.0);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const PlacedObject& answered = scene.objects[i];
    for (const PlacedObject& p : placements) {
      const double evidence = LogLikelihoodRatio(p);
      if (p.object == answered.object || evidence <= out[i]) continue;
      if (SharedVolume(*context.objects[answered.object],
                       answered.scene_from_object,
                       *context.objects[p.object],
                       p.scene_from_object) >
          context.options.acceptance.alternatives.min_shared_volume) {
        out[i] = evidence;
      }
    }
  }
  for (const Alternative& r : alternatives) {
    if (r.placed.object == scene.objects[r.accepted].object) continue;
    out[r.accepted] = std::max(out[r.accepted], LogLikelihoodRatio(r.placed));
  }
  return out;
}

void DropChanceObjects(const JointContext& context,
                       std::span<const PlacedObject> placements,
                       SceneModel* scene) {
  const std::vector<double> best_competing = BestCompeting(context, *scene, placements);
  std::vector<PlacedObject> kept;
  for (std::size_t i = 0; i < scene->objects.size(); ++i) {
    PlacedObject& placed = scene->objects[i];
    const double evidence = LogLikelihoodRatio(placed),
                 penalty = PenaltyLeft(context, evidence, best_competing[i]);
    if (penalty > 0.0 && evidence <= penalty) {
      scene->description_gain -= std::max(0.0, placed.description_gain);
    } else {
      kept.push_back(std::move(placed));
    }
  }
  scene->objects = std::move(kept);
}

double SceneLogOdds(const JointContext& context,
                    const SceneModel& scene,
                    std::span<const double> best_competing) {
  double log_odds = kScenePriorLogOdds;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const double evidence = LogLikelihoodRatio(scene.objects[i]);
    const double penalty =
        PenaltyLeft(context, evidence, best_competing.empty() ? evidence : best_competing[i]);
    // What speaks against an object is no matter of how many there are.
    log_odds += evidence - std::min(penalty, std::max(0.0, evidence));
  }
  return log_odds;
}

double SceneProbability(const JointContext& context,
                        const SceneModel& scene,
                        std::span<const double> best_competing) {
  return Logistic(SceneLogOdds(context, scene, best_competing));
}

std::string ReasonToDoubt(const JointContext& context,
                          const SceneModel& scene,
                          std::span<const double> best_competing) {
  if (scene.objects.empty()) return {};
  if (FocalContradicted(context, scene))
    return "the objects found contradict what is known of the focal lengths";
  const double probability = SceneProbability(context, scene, best_competing);
  if (probability >= context.options.acceptance.scene.min_probability) return {};
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
      context.options.acceptance.scene.min_probability);
}

void DropUnlikelyObjects(const SceneAcceptance& acceptance,
                         SceneModel* scene,
                         std::vector<Alternative>* alternatives) {
  for (int k = static_cast<int>(scene->objects.size()) - 1; k >= 0; --k) {
    if (scene->objects.size() < 2 ||
        ObjectProbability(scene->objects[k]) >= acceptance.min_object_probability)
      continue;
    scene->objects.erase(scene->objects.begin() + k);
    std::erase_if(*alternatives, [k](const Alternative& r) { return r.accepted == k; });
    for (Alternative& r : *alternatives) r.accepted -= r.accepted > k;
  }
}

}  // namespace horopter
