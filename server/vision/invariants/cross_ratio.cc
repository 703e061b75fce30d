#include "server/vision/invariants/cross_ratio.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

double Bracket(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - b.x() * a.y();
}

}  // namespace

CrossRatio CrossRatioOf(const Eigen::Vector2d& t1,
                        const Eigen::Vector2d& t2,
                        const Eigen::Vector2d& t3,
                        const Eigen::Vector2d& t4) {
  return {Bracket(t1, t3) * Bracket(t2, t4), Bracket(t1, t4) * Bracket(t2, t3)};
}

double StereographicAngle(const CrossRatio& lambda) {
  const double phi = 2.0 * std::atan2(2.0 * lambda.numerator - lambda.denominator,
                                      std::sqrt(3.0) * lambda.denominator);
  // atan2 covers both signs of (numerator : denominator): bring 2 atan2 back into (-pi, pi].
  return phi > M_PI ? phi - 2.0 * M_PI : phi <= -M_PI ? phi + 2.0 * M_PI : phi;
}

double FoldedAngle(const CrossRatio& lambda) {
  const double third = 2.0 * M_PI / 3.0;
  const double phi = std::abs(StereographicAngle(lambda));
  const double rest = std::fmod(phi, third);
  return std::min(rest, third - rest);
}

}  // namespace horopter
