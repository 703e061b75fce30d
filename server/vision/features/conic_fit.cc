#include "server/vision/features/conic_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

using Vector5 = Eigen::Matrix<double, 5, 1>;
using Matrix5 = Eigen::Matrix<double, 5, 5>;

constexpr size_t kMinConicPoints = 6;  // one over the five of an ellipse
constexpr double kConverged = 1e-10;   // relative step
constexpr int kMaxCorrelatedLag = 20;  // points along the chain; blur reaches no further
constexpr double kFloatPx = 1e-5;      // what float coordinates hide

absl::Status CheckPoints(std::span<const Eigen::Vector2f> points) {
  if (points.size() < kMinConicPoints) {
    return absl::InvalidArgumentError("points: need at least 6, got " +
                                      std::to_string(points.size()));
  }
  for (size_t i = 0; i < points.size(); ++i) {
    if (!points[i].allFinite()) {
      return absl::InvalidArgumentError("points: " + std::to_string(i) + " is not finite");
    }
  }
  return absl::OkStatus();
}

// How much more the sum of residuals of a fit with five parameters varies than if neighbours were
// independent: the sum of their autocorrelation up to where it vanishes. The fit follows what is
// slow in the noise, which lowers every autocorrelation by about 5 inflation / n: put back.
double VarianceInflation(const std::vector<double>& residuals) {
  const auto n = static_cast<double>(residuals.size());
  double square = 0.0;
  for (double r : residuals) square += r * r;
  std::vector<double> correlation;
  const int most = std::min<int>(kMaxCorrelatedLag, static_cast<int>(residuals.size()) / 4);
  for (int lag = 1; lag <= most && square > 0.0; ++lag) {
    double product = 0.0;
    for (size_t i = lag; i < residuals.size(); ++i) product += residuals[i] * residuals[i - lag];
    if (product <= 0.0) break;
    correlation.push_back(product / square);
  }
  double inflation = 1.0, taken = 0.0;
  for (int round = 0; round < 3; ++round) {
    inflation = 1.0;
    for (double c : correlation) inflation += 2.0 * std::min(c + taken, 1.0);
    taken = std::min(5.0 * inflation / n, 0.2);
  }
  return inflation * n / std::max(n - 5.0 * inflation, 0.5 * n);
}

// Standard deviation of a parameter per unit of the normal equations' inverse: of Student's
// distribution when sigma itself comes from the residuals.
double Sigma(double given, double square, double points, double floor) {
  if (given > 0.0) return given;
  return std::max(std::sqrt(square / std::max(points - 7.0, 1.0)), floor);
}

// Signed distances of points from an ellipse (positive outside) and their derivatives by centre,
// semi-axes and angle.
struct EllipseResiduals {
  Matrix5 normal = Matrix5::Zero();
  Vector5 right = Vector5::Zero();
  double square = 0.0;
  std::vector<double> distances;
};

EllipseResiduals ResidualsOf(const EllipseArc& arc,
                             std::span<const Eigen::Vector2f> points,
                             double blur_sigma_px) {
  const double inside = 0.5 * blur_sigma_px * blur_sigma_px;  // per curvature
  const double c = std::cos(arc.angle_rad), s = std::sin(arc.angle_rad);
  const double a = arc.semi_major_px, b = arc.semi_minor_px;
  EllipseResiduals out;
  for (const Eigen::Vector2f& point : points) {
    const Eigen::Vector2d p = point.cast<double>();
    const Eigen::Vector2d foot = NearestOnEllipse(arc, p), q = foot - arc.center;
    const double u = c * q.x() + s * q.y(), v = -s * q.x() + c * q.y();
    const Eigen::Vector2d gradient(u / (a * a), v / (b * b)), local = gradient.normalized();
    const Eigen::Vector2d normal(c * local.x() - s * local.y(), s * local.x() + c * local.y());
    const double curvature = 1.0 / (a * a * b * b * std::pow(gradient.norm(), 3.0));
    const double d = normal.dot(p - foot) + inside * curvature;
    Vector5 row;  // of -d: how far the curve moves along its normal
    row << normal.x(), normal.y(), local.x() * u / a, local.y() * v / b,
        local.y() * u - local.x() * v;
    out.normal += row * row.transpose();
    out.right += row * d;
    out.square += d * d;
    out.distances.push_back(d);
  }
  return out;
}

EllipseArc Moved(const EllipseArc& arc, const Vector5& step) {
  EllipseArc out = arc;
  out.center += step.head<2>();
  out.semi_major_px += step[2];
  out.semi_minor_px += step[3];
  out.angle_rad += step[4];
  return out;
}

}  // namespace

absl::Status Validate(const ConicFitOptions& options) {
  if (!(options.sigma_px >= 0.0) || !std::isfinite(options.sigma_px)) {
    return absl::InvalidArgumentError("sigma_px: need a finite value >= 0");
  }
  if (!(options.blur_sigma_px >= 0.0) || !std::isfinite(options.blur_sigma_px)) {
    return absl::InvalidArgumentError("blur_sigma_px: need a finite value >= 0");
  }
  if (options.max_iterations < 0) {
    return absl::InvalidArgumentError("max_iterations: need >= 0");
  }
  return absl::OkStatus();
}

absl::StatusOr<EllipseFit> FitEllipseGeometric(std::span<const Eigen::Vector2f> points,
                                               const ConicFitOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  HOROPTER_RETURN_IF_ERROR(CheckPoints(points));
  const std::optional<EllipseArc> start = FitEllipse(points);
  if (!start) {
    return absl::FailedPreconditionError("ellipse: none fits the " + std::to_string(points.size()) +
                                         " points");
  }
  EllipseFit fit;
  fit.arc = *start;
  EllipseResiduals now = ResidualsOf(fit.arc, points, options.blur_sigma_px);
  // Angles weigh as the arc they move, so that damping is the same for all five.
  double damping = 1e-6;
  while (fit.iterations < options.max_iterations) {
    ++fit.iterations;
    Matrix5 damped = now.normal;
    damped.diagonal() = damped.diagonal() * (1.0 + damping) + Vector5::Constant(1e-12);
    const Vector5 step = damped.ldlt().solve(now.right);
    if (!step.allFinite()) break;
    const EllipseArc next = Moved(fit.arc, step);
    const bool valid = next.semi_major_px > 0.0 && next.semi_minor_px > 0.0;
    EllipseResiduals moved =
        valid ? ResidualsOf(next, points, options.blur_sigma_px) : EllipseResiduals();
    if (valid && moved.square <= now.square) {
      fit.arc = next;
      now = std::move(moved);
      damping = std::max(damping * 0.1, 1e-12);
    } else {
      damping *= 10.0;
    }
    if (step.norm() < kConverged * fit.arc.semi_major_px || damping > 1e8) break;
  }
  const auto n = static_cast<double>(points.size());
  const double sigma = Sigma(options.sigma_px, now.square, n, kFloatPx);
  fit.sigma_px =
      sigma * (options.correlated_noise ? std::sqrt(VarianceInflation(now.distances)) : 1.0);
  Matrix5 information = now.normal / (fit.sigma_px * fit.sigma_px);
  information(4, 4) += 12.0 / (M_PI * M_PI);  // an angle uniform over half a turn
  fit.covariance = information.ldlt().solve(Matrix5::Identity());
  if (!fit.covariance.allFinite()) {
    return absl::FailedPreconditionError("ellipse: the points leave its parameters undetermined");
  }
  if (fit.arc.semi_major_px < fit.arc.semi_minor_px) {
    std::swap(fit.arc.semi_major_px, fit.arc.semi_minor_px);
    fit.arc.angle_rad += 0.5 * M_PI;
    fit.covariance.row(2).swap(fit.covariance.row(3));
    fit.covariance.col(2).swap(fit.covariance.col(3));
  }
  fit.arc.angle_rad = std::remainder(fit.arc.angle_rad, M_PI);
  fit.arc.rms_px = std::sqrt(now.square / n);
  SpanInOrder(points, &fit.arc);
  return fit;
}

}  // namespace horopter
