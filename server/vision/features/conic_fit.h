// Ellipses fitted to points by geometric distance, with their covariance (thesis 2.4.2 and 2.4.3).
#pragma once

#include <Eigen/Core>
#include <span>

#include "absl/status/statusor.h"
#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/features.h"

namespace horopter {

struct ConicFitOptions {
  // Deviation of a point across the curve, the same for all and independent; covariances are
  // proportional to its square. 0: taken from the residuals, and covariances are those of Student's
  // distribution, wider when there are few points.
  double sigma_px = 0.0;
  // Take into account that the noise of neighbouring points is alike (edge points share pixels):
  // covariances grow by the sum of the residuals' autocorrelation. Points must be in order.
  bool correlated_noise = false;
  // Blur along the edges the points were found on, optics and edge filter together (the features
  // stage's own is sqrt(5 / 3)), for ellipses: the
  // steepest place of a curved edge lies inside it by curvature x sigma^2 / 2 (Verbeek & van Vliet
  // 1994), which the fit gives back. 0: points are taken as they are.
  double blur_sigma_px = 0.0;
  int max_iterations = 50;
};

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const ConicFitOptions& options);

struct EllipseFit {
  EllipseArc arc;  // rms_px of the orthogonal distances; start and sweep as in FitEllipse
  // Of centre x, y, semi_major_px, semi_minor_px, angle_rad. The angle of a near-circle is bounded
  // by that of no knowledge (90 degrees uniform), so the matrix is always finite.
  Eigen::Matrix<double, 5, 5> covariance = Eigen::Matrix<double, 5, 5>::Zero();
  double sigma_px = 0.0;
  int iterations = 0;
};

// Fits an ellipse: direct fit, then Levenberg-Marquardt on the orthogonal distances.
// Errors: INVALID_ARGUMENT for options, fewer than 6 points or coordinates that are not finite;
// FAILED_PRECONDITION when no ellipse fits.
absl::StatusOr<EllipseFit> FitEllipseGeometric(std::span<const Eigen::Vector2f> points,
                                               const ConicFitOptions& options);

}  // namespace horopter
