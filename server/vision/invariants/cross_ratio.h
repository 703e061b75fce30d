// The cross ratio of four points of a line and its forms that do not depend on their order.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "server/vision/invariants/invariant_key.h"

namespace horopter {

// A cross ratio as a point (numerator : denominator) of the projective line: 0, 1 and infinity are
// ordinary values.
struct CrossRatio {
  double numerator = 0.0;
  double denominator = 1.0;

  double value() const { return numerator / denominator; }
};

// (t1 - t3)(t2 - t4) / ((t1 - t4)(t2 - t3)) of homogeneous points (t, w).
CrossRatio CrossRatioOf(const Eigen::Vector2d& t1,
                        const Eigen::Vector2d& t2,
                        const Eigen::Vector2d& t3,
                        const Eigen::Vector2d& t4);

// Angle phi = 2 atan((2 lambda - 1) / sqrt 3) in (-pi, pi], the stereographic image that puts the
// coincidences 0, 1, infinity at -60, 60, 180 degrees; the six permuted values are its rotations by
// 120 degrees and reflections.
double StereographicAngle(const CrossRatio& lambda);

// Injective on unordered cross ratios with an almost flat density: phi folded into [0, pi/3]. 0 is
// harmonic (-1, 1/2, 2), pi/3 coincident (0, 1, infinity).
double FoldedAngle(const CrossRatio& lambda);

// cos 3 phi: permutation invariant and smooth everywhere, 1 at coincidences and -1 at harmonic
// values; its density piles up at both ends.
double PeriodicCosine(const CrossRatio& lambda);

// j = (lambda^2 - lambda + 1)^3 / (lambda^2 (1 - lambda)^2) >= 27/4; the classical form, unbounded
// at coincidences. 27 / (4 j) = (1 + cos 3 phi) / 2.
double JInvariant(const CrossRatio& lambda);

enum class CrossRatioForm {
  kFoldedAngle,     // flat density, kinks at its ends
  kPeriodicCosine,  // smooth, uneven density
  kJInvariant       // unbounded
};

struct CollinearOptions {
  CrossRatioForm form = CrossRatioForm::kFoldedAngle;
  // Two points whose bracket (ij) is below this share of the largest one reject the set: they
  // (nearly) coincide and the cross ratio says nothing but that.
  double min_ratio = 0.02;
};

// The permutation-invariant form of four points of a line, one value, with its first-order
// covariance. Points are homogeneous (t, w), any scale and sign; covariance is 8 x 8 of the stacked
// coordinates, or empty. Nothing when the set is degenerate.
std::optional<InvariantKey> FourCollinearPoints(std::span<const Eigen::Vector2d, 4> points,
                                                const Eigen::MatrixXd& covariance = {},
                                                const CollinearOptions& options = {});

}  // namespace horopter
