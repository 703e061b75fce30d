// Invariants of six points of projective 3-space under collineations.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/invariants/invariant_key.h"

namespace horopter {

struct SixPointOptions {
  // Consecutive cross ratios nearer than this to 0 or 1 reject the set: a small displacement would
  // change the order. Raising it keeps fewer, better conditioned sets.
  double min_ratio = 0.02;
  // Brackets of the normalised association below this mean that four points are coplanar, so that
  // the associated points of the other two coincide. Exact data only; 0 never.
  double coincidence = 1e-7;
};

// One reading of the set: values are logits of the cross ratios of four consecutive groups.
struct SixPointLabeling {
  InvariantKey key;
  // Point indices group by group in this labeling's order; two sets that match in key match group
  // by group. Points in one group cannot be told apart.
  std::vector<std::vector<int>> groups;
};

// Association (Gale transform): the rows of the null space of X (4 x 6) are six points of P1, and
// [klmn] ~ +-(t_i, t_j) for complementary indices. A collineation keeps their cyclic order up to
// direction, so 2 m labelings remain for m different points; m - 3 invariants.
struct SixPointInvariants {
  int invariants = 0;                       // 3, 2 or 1
  std::vector<SixPointLabeling> labelings;  // [0] is the one to store, all of them are to query
};

// `points` are homogeneous, any scale and sign; `covariance` is that of the 24 stacked coordinates
// or empty. Nothing when the set is degenerate (no invariant) or ill-conditioned.
std::optional<SixPointInvariants> InvariantsOfSixPoints(std::span<const Eigen::Vector4d, 6> points,
                                                        const Eigen::MatrixXd& covariance = {},
                                                        const SixPointOptions& options = {});

// The thesis's form: for each of the 15 axes ij (pairs in lexicographic order) the folded angle of
// the cross ratio of the planes through it and the four other points. Independent of all orders but
// that of the axes.
std::array<double, 15> AxisInvariants(std::span<const Eigen::Vector4d, 6> points);

// Point bijection b[i] of two sets by their axis invariants: every pair of axes that agrees within
// `tolerance` votes for its four pairs of points; the permutation with most votes wins.
std::array<int, 6> MatchByAxes(const std::array<double, 15>& a,
                               const std::array<double, 15>& b,
                               double tolerance);

}  // namespace horopter
