// Least squares of a fundamental matrix over its seven freedoms, free or as two plausible cameras.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

namespace horopter {

// A match in pixels; the higher the weight, the earlier it is sampled and the more it counts.
struct WeightedMatch {
  Eigen::Vector2d a = Eigen::Vector2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
  double weight = 1.0;  // > 0
};

// Signed Sampson distance of a match from F, pixels.
double SignedSampson(const Eigen::Matrix3d& F, const Eigen::Vector2d& a, const Eigen::Vector2d& b);

// What a refined F is and how well its matches determine it.
struct RefinedFundamental {
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();  // unit Frobenius norm, det 0
  double cost = 0.0;  // sum of log(1 + (r / scale)^2) over the matches, without the prior
  std::vector<double> line_sigma_px;  // per match: predicted deviation of its epipolar line in b
};
// Least squares of Sampson distances (Cauchy, scale_px) from F over its seven freedoms. Fewer than
// 8 matches: F unchanged and deviations infinite.
RefinedFundamental RefineFundamental(const Eigen::Matrix3d& F,
                                     std::span<const WeightedMatch> matches,
                                     double scale_px);

// What any lens may be: square pixels, principal point in the middle of the image, focal length
// within reason and free in each image.
struct FocalPrior {
  double width_a = 640, height_a = 480, width_b = 640, height_b = 480;  // px
  double focal_widths = 1.4;     // middle of the prior, image widths
  double log_sigma = 0.5;        // of log(focal length)
  double log_ratio_sigma = 0.3;  // of log(focal length a / focal length b): zooms differ
};

// The same freedoms seen as motion and two focal lengths: two weak priors bend F where the matches
// leave it free. `strain`: how far F is from any pair of such cameras, 1 - s2 / s1 of the
// essential matrix at the best focal lengths of 0.8 - 2.5 widths; right ones of parts-train stay
// under 0.06.
struct CalibratedFundamental {
  RefinedFundamental refined;
  double strain = 0.0;
  double focal_a_px = 0.0, focal_b_px = 0.0;
};
// Of F alone.
double CalibrationStrain(const Eigen::Matrix3d& F, const FocalPrior& prior);
CalibratedFundamental RefineCalibrated(const Eigen::Matrix3d& F,
                                       std::span<const WeightedMatch> matches,
                                       double scale_px,
                                       const FocalPrior& prior);

}  // namespace horopter
