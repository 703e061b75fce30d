// Modes of a set of votes whose number and shape are not known (thesis appendix F).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

enum class ClusterMethod {
  kAdaptiveMeanShift,  // FAMS: Georgescu, Shimshoni and Meer 2003, brute force
  kDensityDerivative,  // NDD: cut where the derivative of a one-dimensional density turns positive
};

struct ClusterOptions {
  ClusterMethod method = ClusterMethod::kAdaptiveMeanShift;
  // Neighbour whose distance is a vote's bandwidth: the larger of the two. Raising them joins
  // modes.
  int min_neighbour = 5;
  double neighbour_share = 0.02;
  // Bounds of the bandwidths, in the votes' units. The smallest should be what noise alone does.
  double min_bandwidth = 0.0;
  double max_bandwidth = 1e300;
  int max_iterations = 60;
  // Shift below which a path has arrived, and distance below which two ends are one mode, both in
  // bandwidths.
  double tolerance = 1e-3;
  double join = 0.5;
  // NDD: a valley cuts when the density there is below this share of the lower of its two peaks.
  double valley = 0.6;
};
// Errors: INVALID_ARGUMENT, names the field.
absl::Status Validate(const ClusterOptions& options);

struct DensityMode {
  Eigen::VectorXd position;
  double weight = 0.0;  // sum over the members
  std::vector<int> members;
};

// votes: one column each; weights: >= 0, one per vote. Every vote is a member of exactly one mode;
// heaviest mode first. Empty without votes. Time grows with the square of the number of votes. The
// same input gives the same modes. Errors: INVALID_ARGUMENT (options, sizes, not finite).
//
// FAMS moves every vote uphill on the density in which vote i has the bandwidth h_i and the weight
// w_i / h_i^(d + 2). NDD (of which the thesis gives the name only) projects on the direction of
// largest scatter, cuts at the minima of the density there, and does so again with each piece until
// none is cut: cheap, for few dimensions.
absl::StatusOr<std::vector<DensityMode>> FindModes(const Eigen::MatrixXd& votes,
                                                   const Eigen::VectorXd& weights,
                                                   const ClusterOptions& options = {});

}  // namespace horopter
