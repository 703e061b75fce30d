#include "server/vision/features/conic_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
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
using Vector6 = ConicCoefficients;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr size_t kMinPoints = 6;        // one over the five of a conic
constexpr int kFootSteps = 12;          // Newton steps to the nearest point of a conic
constexpr double kConverged = 1e-10;    // relative step
constexpr int kMaxCorrelatedLag = 20;   // points along the chain; blur reaches no further
constexpr double kOnePercent = 2.33;    // of a normal distribution
constexpr double kTwoLinesShare = 0.3;  // of the line's variance: see LineIsEnough
constexpr double kFloatPx = 1e-5;       // what float coordinates hide
// A gradient this small (normalised coordinates, unit norm) is that of a line pair's crossing.
constexpr double kMinGradient = 1e-3;

absl::Status CheckPoints(std::span<const Eigen::Vector2f> points) {
  if (points.size() < kMinPoints) {
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

// Points moved and scaled: u = (x - origin) / scale (thesis 2.4.3).
struct Normalized {
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  double scale = 0.0;
  std::vector<Eigen::Vector2d> points;
};

Normalized Normalize(std::span<const Eigen::Vector2f> points) {
  Normalized out;
  const auto n = static_cast<double>(points.size());
  for (const Eigen::Vector2f& p : points) out.origin += p.cast<double>() / n;
  double square = 0.0;
  for (const Eigen::Vector2f& p : points) square += (p.cast<double>() - out.origin).squaredNorm();
  out.scale = std::sqrt(square / n);
  for (const Eigen::Vector2f& p : points) {
    out.points.push_back((p.cast<double>() - out.origin) / out.scale);
  }
  return out;
}

Vector6 Monomials(const Eigen::Vector2d& p) {
  Vector6 m;
  m << p.x() * p.x(), p.x() * p.y(), p.y() * p.y(), p.x(), p.y(), 1.0;
  return m;
}

Eigen::Vector2d Gradient(const Vector6& q, const Eigen::Vector2d& p) {
  return {2.0 * q[0] * p.x() + q[1] * p.y() + q[3], q[1] * p.x() + 2.0 * q[2] * p.y() + q[4]};
}

// Taubin 1991: least (sum Q^2) / (sum |grad Q|^2).
std::optional<Vector6> FitTaubin(const std::vector<Eigen::Vector2d>& points) {
  const auto n = static_cast<double>(points.size());
  Vector6 mean = Vector6::Zero();
  for (const Eigen::Vector2d& p : points) mean += Monomials(p) / n;
  Matrix5 M = Matrix5::Zero(), N = Matrix5::Zero();
  for (const Eigen::Vector2d& p : points) {
    const Vector5 m = (Monomials(p) - mean).head<5>();
    Vector5 x, y;
    x << 2.0 * p.x(), p.y(), 0.0, 1.0, 0.0;
    y << 0.0, p.x(), 2.0 * p.y(), 0.0, 1.0;
    M += m * m.transpose();
    N += x * x.transpose() + y * y.transpose();
  }
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix5> solver(M, N);
  if (solver.info() != Eigen::Success || !solver.eigenvectors().allFinite()) return std::nullopt;
  Vector6 q;
  q.head<5>() = solver.eigenvectors().col(0);
  q[5] = -q.head<5>().dot(mean.head<5>());
  return q.normalized();
}

// The foot of `p` on Q = 0 near it: Newton's method on Q(x) = 0, (p - x) x grad Q(x) = 0.
std::optional<Eigen::Vector2d> Foot(const Vector6& q, const Eigen::Vector2d& p) {
  Eigen::Vector2d x = p;
  for (int i = 0; i < kFootSteps; ++i) {
    const Eigen::Vector2d g = Gradient(q, x), r = p - x;
    const Eigen::Vector2d value(q.dot(Monomials(x)), r.x() * g.y() - r.y() * g.x());
    Eigen::Matrix2d jacobian;
    jacobian << g.x(), g.y(), -g.y() + r.x() * q[1] - 2.0 * r.y() * q[0],
        g.x() + 2.0 * r.x() * q[2] - r.y() * q[1];
    const double determinant = jacobian.determinant();
    if (!(std::abs(determinant) > kMinGradient * kMinGradient)) return std::nullopt;
    const Eigen::Vector2d step = jacobian.inverse() * value;
    x -= step;
    if (step.norm() < 1e-13) break;
  }
  if (!x.allFinite() || std::abs(q.dot(Monomials(x))) > 1e-9) return std::nullopt;
  return x;
}

// Distances d (signed) from a conic and their normal equations in the five directions `basis` that
// keep its norm: the derivative of d is m(foot) / |grad Q(foot)|.
struct Linearized {
  Matrix5 normal = Matrix5::Zero();
  Vector5 right = Vector5::Zero();
  double square = 0.0;
  std::vector<double> distances;
};

Eigen::Matrix<double, 6, 5> TangentBasis(const Vector6& q) {
  const Eigen::Matrix<double, 6, 6> full = Eigen::HouseholderQR<Vector6>(q).householderQ();
  return full.rightCols<5>();
}

Linearized Linearize(const std::vector<Eigen::Vector2d>& points, const Vector6& q) {
  const Eigen::Matrix<double, 6, 5> basis = TangentBasis(q);
  Linearized out;
  for (const Eigen::Vector2d& p : points) {
    const std::optional<Eigen::Vector2d> foot = Foot(q, p);
    const Eigen::Vector2d at = foot.value_or(p);
    const Eigen::Vector2d g = Gradient(q, at);
    // Beside the crossing of a line pair no direction across the curve is defined.
    const double slope = std::max(g.norm(), kMinGradient);
    const double d = foot ? (p - *foot).dot(g) / slope : q.dot(Monomials(p)) / slope;
    const Vector5 row = basis.transpose() * Monomials(at) / slope;
    out.normal += row * row.transpose();
    out.right += row * d;
    out.square += d * d;
    out.distances.push_back(d);
  }
  return out;
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

// How many deviations a function of the conic with this gradient is away from 0.
double Significance(double value, const Vector6& gradient, const Matrix6& covariance) {
  return std::abs(value) / std::sqrt(std::max(gradient.dot(covariance * gradient), 1e-300));
}

ConicType Classify(const Vector6& q, const Matrix6& covariance, double sigmas) {
  const double a = q[0], b = q[1], c = q[2], d = q[3], e = q[4], f = q[5];
  const double discriminant = b * b - 4.0 * a * c;
  Vector6 slope;
  slope << -4.0 * c, 2.0 * b, -4.0 * a, 0.0, 0.0, 0.0;
  const bool open = Significance(discriminant, slope, covariance) < sigmas;
  // 4 x determinant of the symmetric matrix, and its derivatives.
  const double determinant = 4.0 * a * c * f + b * d * e - a * e * e - c * d * d - f * b * b;
  Vector6 by;
  by << 4.0 * c * f - e * e, d * e - 2.0 * f * b, 4.0 * a * f - d * d, b * e - 2.0 * c * d,
      b * d - 2.0 * a * e, 4.0 * a * c - b * b;
  const bool flat = Significance(determinant, by, covariance) < sigmas;
  if (flat && (open || discriminant > 0.0)) return ConicType::kLinePair;
  if (open) return ConicType::kParabola;
  return discriminant < 0.0 ? ConicType::kEllipse : ConicType::kHyperbola;
}

// Smaller eigenvalue of the scatter of points of mean 0: squares about their line.
double SquaresAboutLine(const std::vector<Eigen::Vector2d>& points) {
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& p : points) scatter += p * p.transpose();
  return std::max(Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter).eigenvalues()[0], 0.0);
}

// Two lines beside each other fit a noisy line too, and leave 0.36 of its squares: a conic has to
// leave fewer, and the line more than the noise when that is given.
bool LineIsEnough(double line_square, double conic_square, double sigma, double n) {
  const double expected = sigma * sigma * (n - 2.0 + kOnePercent * std::sqrt(2.0 * (n - 2.0)));
  return line_square <= expected ||
         kTwoLinesShare * line_square / (n - 2.0) <= conic_square / std::max(n - 5.0, 1.0);
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
  if (!(options.decision_sigmas >= 0.0)) {
    return absl::InvalidArgumentError("decision_sigmas: need >= 0");
  }
  if (options.max_iterations < 0) {
    return absl::InvalidArgumentError("max_iterations: need >= 0");
  }
  return absl::OkStatus();
}

absl::StatusOr<ConicFit> FitConic(std::span<const Eigen::Vector2f> points,
                                  const ConicFitOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  HOROPTER_RETURN_IF_ERROR(CheckPoints(points));
  const Normalized normalized = Normalize(points);
  const absl::Status undetermined = absl::FailedPreconditionError(
      "conic: a line fits the " + std::to_string(points.size()) + " points as well");
  if (!(normalized.scale > kFloatPx) || !std::isfinite(normalized.scale)) return undetermined;
  std::optional<Vector6> start = FitTaubin(normalized.points);
  if (!start) return undetermined;
  Vector6 q = *start;
  Linearized now = Linearize(normalized.points, q);
  ConicFit fit;
  double damping = 1e-6;
  while (fit.iterations < options.max_iterations) {
    ++fit.iterations;
    Matrix5 damped = now.normal;
    damped.diagonal() *= 1.0 + damping;
    const Vector5 step = -damped.ldlt().solve(now.right);
    if (!step.allFinite()) break;
    const Vector6 next = (q + TangentBasis(q) * step).normalized();
    Linearized moved = Linearize(normalized.points, next);
    if (moved.square <= now.square) {
      q = next;
      now = std::move(moved);
      damping = std::max(damping * 0.1, 1e-12);
    } else {
      damping *= 10.0;
    }
    if (step.norm() < kConverged || damping > 1e8) break;
  }
  const double sigma = Sigma(options.sigma_px / normalized.scale,
                             now.square,
                             static_cast<double>(points.size()),
                             kFloatPx / normalized.scale);
  const double inflation = options.correlated_noise ? VarianceInflation(now.distances) : 1.0;
  if (LineIsEnough(SquaresAboutLine(normalized.points),
                   now.square,
                   std::max(options.sigma_px, kFloatPx) / normalized.scale,
                   static_cast<double>(points.size()))) {
    return undetermined;
  }
  const Matrix5 inverse = now.normal.ldlt().solve(Matrix5::Identity());
  if (!inverse.allFinite()) return undetermined;
  const Eigen::Matrix<double, 6, 5> basis = TangentBasis(q);
  const Matrix6 covariance = sigma * sigma * inflation * basis * inverse * basis.transpose();
  fit.type = Classify(q, covariance, options.decision_sigmas);
  fit.rms_px = normalized.scale * std::sqrt(now.square / static_cast<double>(points.size()));
  fit.sigma_px = normalized.scale * sigma * std::sqrt(inflation);
  fit.origin_px = normalized.origin;
  fit.scale_px = normalized.scale;
  fit.conic = q;
  fit.covariance = covariance;
  return fit;
}

ConicCoefficients ConicInPixels(const ConicFit& fit) {
  const ConicCoefficients& q = fit.conic;
  const double s = 1.0 / fit.scale_px, x = -s * fit.origin_px.x(), y = -s * fit.origin_px.y();
  ConicCoefficients out;  // q at (s px + x, s py + y)
  out << s * s * q[0], s * s * q[1], s * s * q[2], s * (2.0 * x * q[0] + y * q[1] + q[3]),
      s * (x * q[1] + 2.0 * y * q[2] + q[4]), q.dot(Monomials({x, y}));
  return out.normalized();
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
