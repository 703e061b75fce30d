// Conics fitted to points by geometric distance, with their type and covariance (thesis 2.4.2 and
// 2.4.3).
#pragma once

#include <Eigen/Core>
#include <span>

#include "absl/status/statusor.h"
#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/features.h"

namespace horopter {

enum class ConicType {
  kEllipse,
  kHyperbola,
  kParabola,  // or cannot be told from one: b^2 - 4 a c is 0 within its deviation
  kLinePair,  // or cannot be told from one: the determinant is 0 within its deviation
};

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
  // Deviations a discriminant must be away from 0 to decide the type. Higher: more parabolas and
  // line pairs.
  double decision_sigmas = 3.0;
  int max_iterations = 50;
};

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const ConicFitOptions& options);

// a u^2 + b uv + c v^2 + d u + e v + f = 0, of norm 1, in coordinates (u, v) = (x - origin_px) /
// scale_px in which the points have mean 0 and size 1: in pixels the norm would be all f, and no
// covariance of first order could be true.
struct ConicFit {
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
  double scale_px = 1.0;
  ConicCoefficients conic = ConicCoefficients::Zero();
  // Of `conic`; rank 5: none along `conic` itself, whose norm is fixed.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  ConicType type = ConicType::kEllipse;
  double rms_px = 0.0;    // of the distances from the curve
  double sigma_px = 0.0;  // what the covariance assumes
  int iterations = 0;
};

// Fits a conic of any type to at least 6 points (pixels): Taubin's fit in coordinates moved and
// scaled to mean 0 and size 1, then Gauss-Newton on the orthogonal distances (feet by Newton's
// method). First-order covariance; type decided by b^2 - 4 a c and the determinant against theirs.
// Errors: INVALID_ARGUMENT for options, too few points or coordinates that are not finite;
// FAILED_PRECONDITION when the points coincide or a line fits them as well: the arc rises by less
// than about 6 deviations.
absl::StatusOr<ConicFit> FitConic(std::span<const Eigen::Vector2f> points,
                                  const ConicFitOptions& options);

// The conic in pixels, of norm 1.
ConicCoefficients ConicInPixels(const ConicFit& fit);

struct EllipseFit {
  EllipseArc arc;  // rms_px of the orthogonal distances; start and sweep as in FitEllipse
  // Of centre x, y, semi_major_px, semi_minor_px, angle_rad. The angle of a near-circle is bounded
  // by that of no knowledge (90 degrees uniform), so the matrix is always finite.
  Eigen::Matrix<double, 5, 5> covariance = Eigen::Matrix<double, 5, 5>::Zero();
  double sigma_px = 0.0;
  int iterations = 0;
};

// Fits an ellipse: direct fit, then Levenberg-Marquardt on the orthogonal distances.
// Errors: INVALID_ARGUMENT as FitConic; FAILED_PRECONDITION when no ellipse fits.
absl::StatusOr<EllipseFit> FitEllipseGeometric(std::span<const Eigen::Vector2f> points,
                                               const ConicFitOptions& options);

}  // namespace horopter
