// Epipolar geometry of matches of which some are wrong, without any assumption on the cameras.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/vision/matching/fundamental_refinement.h"
#include "server/vision/matching/matching_options.h"

namespace horopter {

struct RobustFundamental {
  std::optional<Eigen::Matrix3d> F;  // x_b^T F x_a = 0, unit Frobenius norm
  std::vector<int> inliers;          // indices of the matches
  int off_homography = 0;
  double sigma_px = 0.0;  // predicted deviation of the worst inlier's epipolar line
  std::string refusal;    // why F is empty
};

// Seven-point samples drawn likely matches first (PROSAC's idea), truncated squared distances
// (MSAC), all inliers on one side of both epipoles (oriented constraint, Chum et al. 2004), local
// optimisation of every new best, then least squares over the seven freedoms of F with Cauchy
// weights. Deterministic for a seed.
RobustFundamental EstimateFundamental(std::span<const WeightedMatch> matches,
                                      const RobustFundamentalOptions& options);

}  // namespace horopter
