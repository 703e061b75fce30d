// The cross ratio of four points of a line and its forms that do not depend on their order.
#pragma once

#include <Eigen/Core>

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

}  // namespace horopter
