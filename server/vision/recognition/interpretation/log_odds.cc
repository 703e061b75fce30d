#include "server/vision/recognition/interpretation/log_odds.h"

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

double UnknownOdds(double unknown_share) {
  return unknown_share / (1.0 - unknown_share) * (1.0 - kNominalUnknownShare) /
         kNominalUnknownShare;
}

double WithUnknownShare(double probability, double unknown_share) {
  return probability / (probability + (1.0 - probability) * UnknownOdds(unknown_share));
}

}  // namespace horopter
