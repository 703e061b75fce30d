// Invariants of sets with lines under collineations, in forms that do not
// depend on the order of the points or of the lines. Lines are Plücker six-vectors (direction;
// moment), points homogeneous; any scale and sign.
//
// They are computed for a measured set but not stored: no table of the catalog's index holds them.
// `line_set_report` (tests/bench/results.md) found four lines usable once in 200 draws of a median
// part and on 13 of 20 parts at all, as four edges of a right-angled part have three directions. A
// measured set of points and lines meets 3 - 36 times as many keys of other parts as six points,
// which 18 of the parts have; 19 have sets of points and lines.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "server/vision/invariants/invariant_key.h"

namespace horopter {

struct LineSetOptions {
  // Smallest of the products that form the invariants relative to the largest; below, two features
  // (nearly) meet and the set is rejected. Raising it keeps fewer, better conditioned sets.
  double min_ratio = 0.02;
};

// All take the covariance of the stacked coordinates (points first, then lines; 4 and 6 each) or an
// empty one, and return nothing when the set is degenerate.

// Four lines, 2 invariants: (a : b : c) = ((12)(34) : (13)(24) : (14)(23)) with (ij) the incidence
// product, scaled so that the largest in magnitude is 1, the other two ascending, each in [-1, 1].
std::optional<InvariantKey> FourLines(std::span<const Vector6d, 4> lines,
                                      const Eigen::MatrixXd& covariance = {},
                                      const LineSetOptions& options = {});

// Four points and a line, 1 invariant: its Plücker coordinates in the basis of the points give
// products l12 l34 + l13 l42 + l14 l23 = 0, a cross ratio; folded angle.
std::optional<InvariantKey> FourPointsOneLine(std::span<const Eigen::Vector4d, 4> points,
                                              const Vector6d& line,
                                              const Eigen::MatrixXd& covariance = {},
                                              const LineSetOptions& options = {});

// Three points and two lines, 2 invariants: the lines meet the plane of the points in u and v; log
// ratios of their coordinates, centred, ascending; the middle one and half the range.
std::optional<InvariantKey> ThreePointsTwoLines(std::span<const Eigen::Vector4d, 3> points,
                                                std::span<const Vector6d, 2> lines,
                                                const Eigen::MatrixXd& covariance = {},
                                                const LineSetOptions& options = {});

// Two points and three lines, 3 invariants: on each line the four planes through a point and
// another line cut out a cross ratio; folded angles, ascending.
std::optional<InvariantKey> TwoPointsThreeLines(std::span<const Eigen::Vector4d, 2> points,
                                                std::span<const Vector6d, 3> lines,
                                                const Eigen::MatrixXd& covariance = {},
                                                const LineSetOptions& options = {});

// Five points and a line, 4 invariants in 10 values: FourPointsOneLine of the five subsets,
// ascending (planes through the line and the points: only 2 invariants), then for each point left
// out the mean folded angle of the pairings of the other four on the line, ascending. The
// covariance has rank 4; add a floor before inverting it.
std::optional<InvariantKey> FivePointsOneLine(std::span<const Eigen::Vector4d, 5> points,
                                              const Vector6d& line,
                                              const Eigen::MatrixXd& covariance = {},
                                              const LineSetOptions& options = {});

// Helpers shared with their tests. Plücker line through two homogeneous points, and its image under
// a collineation.
Vector6d LineThrough(const Eigen::Vector4d& a, const Eigen::Vector4d& b);
Vector6d TransformLine(const Eigen::Matrix4d& collineation, const Vector6d& line);

}  // namespace horopter
