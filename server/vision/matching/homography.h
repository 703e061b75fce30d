// Plane homographies: estimation from point pairs, refinement, and the conditions a real one meets.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>

namespace horopter {

// Point pair in pixels; b ~ H a for the pairs of one plane.
struct PointPair {
  Eigen::Vector2d a = Eigen::Vector2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
};

// Image of x (pixels) under H. A point on the vanishing line gives non-finite or huge values, never
// a trap.
inline Eigen::Vector2d Transfer(const Eigen::Matrix3d& H, const Eigen::Vector2d& x) {
  const Eigen::Vector3d y = H.leftCols<2>() * x + H.col(2);
  return y.head<2>() / y.z();
}

// Larger of the two transfer errors |b - H a| and |a - H^-1 b|, pixels.
double SymmetricTransferError(const Eigen::Matrix3d& H,
                              const Eigen::Matrix3d& H_inverse,
                              const PointPair& pair);

// Jacobian d(Transfer(H, x)) / dx.
Eigen::Matrix2d TransferJacobian(const Eigen::Matrix3d& H, const Eigen::Vector2d& x);

// H scaled to determinant 1 (the sign follows: a homography between two views of one side of a
// plane has det > 0 once all transferred points have w > 0). A singular or non-finite H gives
// nullopt.
std::optional<Eigen::Matrix3d> NormalizeDeterminant(const Eigen::Matrix3d& H);

// Least squares: minimises sum |b - H a|^2 by Gauss-Newton from H (8 parameters, normalised
// coordinates). Needs >= 4 pairs in general position; returns H unchanged when the normal equations
// are singular.
Eigen::Matrix3d RefineHomography(const Eigen::Matrix3d& H, std::span<const PointPair> pairs);

// Linear estimate (normalised DLT). Fewer than 4 pairs or a singular configuration: nullopt.
std::optional<Eigen::Matrix3d> FitHomography(std::span<const PointPair> pairs);

// Bounds of a homography that two cameras looking at the same side of a plane can give, and that
// its inliers determine.
struct HomographyLimits {
  double max_area_change = 25.0;  // local area scale within [1/this, this] at every inlier
  double min_spread_px =
      10.0;  // standard deviation of the inliers across their long direction, in both images
  double min_spread_ratio = 0.04;  // ... and relative to the long direction: no collinear sets
};

// Empty when H is plausible for its inliers, else the reason, with numbers.
std::string ImplausibleHomography(const Eigen::Matrix3d& H,
                                  std::span<const PointPair> inliers,
                                  const HomographyLimits& limits = {});

}  // namespace horopter
