// Modes of a set of votes whose number and shape are not known (thesis appendix F).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

struct ClusterOptions {
  // Bounds of the bandwidths, in the votes' units. The smallest should be what noise alone does.
  double min_bandwidth = 0.0;
  double max_bandwidth = 1e300;
  double join = 0.5;  // bandwidths; ends of paths nearer than this are one mode
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
// Fixed-width adaptive mean shift (Georgescu, Shimshoni and Meer 2003), brute force: every vote
// moves uphill on the density in which vote i has the bandwidth h_i, the distance to a near
// neighbour, and the weight w_i / h_i^(d + 2).
absl::StatusOr<std::vector<DensityMode>> FindModes(const Eigen::MatrixXd& votes,
                                                   const Eigen::VectorXd& weights,
                                                   const ClusterOptions& options = {});

}  // namespace horopter
