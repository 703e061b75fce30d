// Epipolar geometry of matches of which some are wrong, without any assumption on the cameras.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/vision/matching/fundamental_refinement.h"

namespace horopter {

struct RobustFundamentalOptions {
  double inlier_px = 2.0;  // Sampson distance; higher: more inliers, more wrong ones
  int hypotheses = 1500;   // samples of seven
  int min_inliers = 10;    // seven always agree
  double min_share = 0.4;  // of the matches; fewer agree by chance
  // Inliers that the best homography does not explain, at least, and their share: before a plane F
  // has two freedoms left that wrong matches fill (98 % inliers and still wrong: measured).
  int min_off_homography = 6;
  double min_off_homography_share = 0.2;
  double homography_px = 3.0;
  // Largest predicted deviation of an epipolar line at an inlier.
  double max_sigma_px = 1.0;
  unsigned seed = 1;
};

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
