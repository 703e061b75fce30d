#include "server/vision/recognition/interpretation/decision_cues.h"

#include <algorithm>
#include <cmath>

#include "server/vision/recognition/interpretation/learnt_cue_weights.h"

namespace horopter {
namespace {

constexpr double kSupportOffsetPx = 50.0;
constexpr double kMostGround = 0.4;
constexpr int kTellingViews = 3;
// Of another part; by chance many scenes have one of less.
constexpr double kTellingScore = 0.40, kTellingLying = 0.32;

double MeanSupport(const LinkedObject& o) {
  double n = 0.0, sum = 0.0;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (!o.shown[v]) continue;
    sum += o.views[v].support_px;
    n += 1.0;
  }
  return sum / std::max(1.0, n);
}

// Of those that say something.
double BestOther(const LinkedObject& o, const LinkedScene& scene) {
  double best = 0.0;
  for (const LinkedObject& other : scene.objects) {
    if (other.object != o.object && other.score >= (other.lies ? kTellingLying : kTellingScore))
      best = std::max(best, other.score);
  }
  return best;
}

// What cameras that are wrong, or a part that is elsewhere, mostly leave of it.
constexpr double kChanceGround = 0.2;
constexpr double kTellingTexture = 7.0;  // AspectAcceptance::telling_texture
constexpr double kSureLogOdds = 0.85;    // of a part that others rest on: probability .7

double GroundAboveChance(const ViewAgreement& views) {
  if (views.texture < kTellingTexture) return 0.0;
  return std::min(views.ground, kMostGround) - kChanceGround;
}

// But for `company`.
CameraCues CuesAlone(const LinkedObject& o, const LinkedScene& scene) {
  double least = 1.0, shown = 0.0;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (!o.shown[v]) continue;
    least = std::min(least, o.views[v].precision);
    shown += 1.0;
  }
  const double images = static_cast<double>(scene.views.size());
  return {o.precision,
          o.score,
          shown > 0.0 ? least : 0.0,
          std::log(MeanSupport(o) + kSupportOffsetPx),
          std::log(std::max(1.0, shown)),
          images > 0.0 ? 1.0 - scene.registered() / images : 0.0,
          o.lies ? 1.0 : 0.0,
          GroundAboveChance(scene.agreement),
          0.0};
}

}  // namespace

DecisionCues CuesOf(const LinkedObject& o, const LinkedScene& scene) {
  const LinkedObject& best = scene.objects.front();
  const bool first = o.object == best.object && o.score == best.score;
  const double images = static_cast<double>(scene.views.size());
  const double ground = scene.agreement.ground;
  const auto flag = [](bool value) { return value ? 1.0 : 0.0; };
  return {o.precision,
          o.score,
          std::log(MeanSupport(o) + kSupportOffsetPx),
          flag(o.surface_pairs > 0),
          ground,
          flag(o.lies),
          flag(o.level && !o.lies),
          images > 0.0 ? 1.0 - scene.registered() / images : 0.0,
          flag(scene.registered() == 1),
          flag(first),
          first ? BestOther(o, scene) : 0.0,
          first && scene.registered() >= kTellingViews ? std::min(kMostGround, ground) : 0.0};
}

const std::array<std::string_view, kDecisionCues>& CueNames() {
  static constexpr std::array<std::string_view, kDecisionCues> kNames = {"precision",
                                                                         "score",
                                                                         "log_support",
                                                                         "surface_seen",
                                                                         "ground",
                                                                         "lies",
                                                                         "level",
                                                                         "missing",
                                                                         "one",
                                                                         "first",
                                                                         "first_other",
                                                                         "first_ground"};
  return kNames;
}

double FittedLogOdds(const DecisionCues& cues) {
  double out = kCueConstant;
  for (std::size_t i = 0; i < kDecisionCues; ++i) out += kCueWeights[i] * cues[i];
  return out;
}

CameraCues CameraCuesOf(const LinkedObject& o, const LinkedScene& scene) {
  CameraCues cues = CuesAlone(o, scene);
  const LinkedObject& best = scene.objects.front();
  const bool other = o.score < best.score;
  if (other && FittedLogOdds(CuesAlone(best, scene)) >= kSureLogOdds) cues.back() = 1.0;
  return cues;
}

double FittedLogOdds(const CameraCues& cues) {
  double out = kCameraCueConstant;
  for (std::size_t i = 0; i < kCameraCues; ++i) out += kCameraCueWeights[i] * cues[i];
  return out;
}

}  // namespace horopter
