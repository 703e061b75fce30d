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

double PeriodicCosine(const CrossRatio& lambda) {
  return std::cos(3.0 * StereographicAngle(lambda));
}

double JInvariant(const CrossRatio& lambda) {
  const double n = lambda.numerator, d = lambda.denominator;
  const double top = n * n - n * d + d * d, bottom = n * d * (d - n);
  return top * top * top / (bottom * bottom);
}

std::optional<InvariantKey> FourCollinearPoints(std::span<const Eigen::Vector2d, 4> points,
                                                const Eigen::MatrixXd& covariance,
                                                const CollinearOptions& options) {
  double least = INFINITY, most = 0.0;
  Eigen::VectorXd x(8);
  for (int i = 0; i < 4; ++i) {
    x.segment<2>(2 * i) = points[i];
    for (int j = 0; j < i; ++j) {
      const double bracket = std::abs(Bracket(points[i].normalized(), points[j].normalized()));
      least = std::min(least, bracket);
      most = std::max(most, bracket);
    }
  }
  if (!x.allFinite() || !(least > options.min_ratio * most)) return std::nullopt;
  const auto value = [&](const Eigen::VectorXd& at) -> Eigen::VectorXd {
    const CrossRatio lambda =
        CrossRatioOf(at.segment<2>(0), at.segment<2>(2), at.segment<2>(4), at.segment<2>(6));
    double form = 0.0;
    switch (options.form) {
      case CrossRatioForm::kFoldedAngle:
        form = FoldedAngle(lambda);
        break;
      case CrossRatioForm::kPeriodicCosine:
        form = PeriodicCosine(lambda);
        break;
      case CrossRatioForm::kJInvariant:
        form = JInvariant(lambda);
        break;
    }
    return Eigen::VectorXd::Constant(1, form);
  };
  InvariantKey key{value(x), {}};
  if (covariance.size() > 0) key.covariance = PropagateCovariance(value, x, covariance);
  return key;
}

}  // namespace horopter
