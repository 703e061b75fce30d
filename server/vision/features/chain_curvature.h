// Curvature along an edge chain (thesis 2.3).
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/features/feature_options.h"

namespace horopter {

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const CurvatureOptions& options);

// Signed curvature (1/px) at every point of an ordered chain, positive where the chain turns from x
// towards y (clockwise on the screen), never beyond +-1. A closed chain wraps around; on an open
// one the l points at each end have the value of the nearest full window. Chains shorter than a
// window get a smaller one; fewer than 5 points have curvature 0. Costs O(points) whatever l is:
// the window's moments are updated, not recomputed.
// Errors: INVALID_ARGUMENT for options or coordinates that are not finite.
absl::StatusOr<std::vector<double>> ChainCurvature(std::span<const Eigen::Vector2f> points,
                                                   bool closed,
                                                   const CurvatureOptions& options);

}  // namespace horopter
