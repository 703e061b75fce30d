#include "server/vision/recognition/scoring/log_odds.h"

#include <algorithm>
#include <cmath>

#include "server/vision/recognition/learnt_constants.h"

namespace horopter {
double Logistic(double log_odds) {
  return 1.0 / (1.0 + std::exp(-log_odds));
}

double StatedProbability(double probability, double pose_probability) {
  constexpr double kMost = 1.0 - 1e-12;  // whose log odds are finite
  const double p = std::clamp(probability, 1.0 - kMost, kMost);
  return Logistic(std::log(p / (1.0 - p)) + kAnsweredLogOdds) * pose_probability;
}

double EdgeLogLikelihoodRatio(double support, double sharpness) {
  return std::max(0.0,
                  kSceneSupportWeight * (support - kChanceSupport) +
                      kSceneSharpnessWeight * (sharpness - kChanceSupport));
}

double TextureLogOdds(double texture, double sharpness) {
  if (texture <= 0.0) return texture;
  return kTextureWeight * texture *
         std::clamp(1.0 - (kChanceSupport - sharpness) / kBluntness, 0.0, 1.0);
}

double MultipleTestingPenalty(std::size_t objects) {
  return std::max(0.0, std::log(static_cast<double>(objects) / kLearntCatalogObjects));
}

}  // namespace horopter
