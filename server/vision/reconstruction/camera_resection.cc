#include "server/vision/reconstruction/camera_resection.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <optional>
#include <random>
#include <string>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kParameters = 7;       // rotation, translation, log f
constexpr int kRefinements = 12;     // Gauss-Newton steps
constexpr double kLossPx = 1.0;      // Cauchy
constexpr double kLineWeight = 0.5;  // a line of two views agrees with more poses than a point
constexpr double kMinSigmaPx = 0.3;  // of features; what fits better does so by chance
constexpr double kFar = 1e6;         // px: the error of what cannot be projected
// Chance that no sample was of right points only. Noisy triangles make poor poses: low.
constexpr double kMissed = 1e-6;

using Vector7d = Eigen::Matrix<double, kParameters, 1>;
using Matrix7d = Eigen::Matrix<double, kParameters, kParameters>;

Eigen::Vector2d PointError(const CalibratedCamera& pose, const PointSight& s) {
  const Eigen::Vector3d x = pose.camera_from_scene * s.point_in_world;
  if (x.z() <= 0.0) return Eigen::Vector2d::Constant(kFar);
  return Project(pose.camera, x) - s.pixel;
}

// Distances of both ends, lens distortion undone, from the projected line.
Eigen::Vector2d LineError(const CalibratedCamera& pose, const LineSight& s) {
  const Eigen::Vector3d d = s.line_in_world.head<3>(), m = s.line_in_world.tail<3>();
  const Rigid3& T = pose.camera_from_scene;
  // Moment about the camera's centre is the normal of the plane through it.
  const Eigen::Vector3d l = T.R * m + T.t.cross(T.R * d);
  const double norm = l.head<2>().norm();
  if (!(norm > 0.0)) return Eigen::Vector2d::Constant(kFar);
  const double f = pose.camera.focal_px;
  return Eigen::Vector2d(l.dot(NormalizedPoint(pose.camera, s.start).homogeneous()),
                         l.dot(NormalizedPoint(pose.camera, s.end).homogeneous())) *
         (f / norm);
}

CalibratedCamera Moved(const CalibratedCamera& pose, const Vector7d& step) {
  CalibratedCamera next = pose;
  const Eigen::Vector3d w = step.head<3>();
  const double angle = w.norm();
  if (angle > 0.0) {
    next.camera_from_scene.R =
        Eigen::AngleAxisd(angle, w / angle).toRotationMatrix() * pose.camera_from_scene.R;
  }
  next.camera_from_scene.t += step.segment<3>(3);
  next.camera.focal_px *= std::exp(std::clamp(step(6), -1.0, 1.0));
  return next;
}

class Problem {
 public:
  Problem(std::span<const PointSight> points,
          std::span<const LineSight> lines,
          const ImageSize& size,
          const ViewPrior& prior,
          const ResectionOptions& options)
      : points_(points), lines_(lines), options_(options) {
    log_focal_ = std::log(prior.focal_px.value_or(options.focal_prior_widths * size.width));
    log_sigma_ = prior.focal_px ? prior.focal_log_sigma : options.focal_prior_log_sigma;
  }

  // Truncated squares of the points, in gates; half of that for lines. Lower is better.
  double Score(const CalibratedCamera& pose, double best) const {
    const double gate2 = options_.gate_px * options_.gate_px;
    double score = 0.0;
    for (const PointSight& s : points_) {
      score += std::min(PointError(pose, s).squaredNorm() / gate2, 1.0);
      if (score >= best) return score;
    }
    for (const LineSight& s : lines_) {
      score += kLineWeight * std::min(LineError(pose, s).squaredNorm() / gate2, 1.0);
      if (score >= best) return score;
    }
    return score;
  }

  // Posterior deviation when observations deviate by sigma_px.
  double FocalLogSigma(const Matrix7d& normal, double sigma_px) const {
    Matrix7d posterior = normal / (sigma_px * sigma_px);
    posterior(6, 6) += 1.0 / (log_sigma_ * log_sigma_);
    // Free parameters that nothing moves stay solvable.
    posterior.diagonal() *= 1.0 + 1e-12;
    return std::sqrt(posterior.ldlt().solve(Vector7d::Unit(6))(6));
  }

  int Agreeing(const CalibratedCamera& pose) const {
    const double gate2 = options_.gate_px * options_.gate_px;
    return static_cast<int>(std::count_if(points_.begin(), points_.end(), [&](const PointSight& s) {
      return PointError(pose, s).squaredNorm() < gate2;
    }));
  }

  // Gauss-Newton with a Cauchy loss on what is within the gate; the observations' normal matrix at
  // the end, for 1 px.
  Matrix7d Refine(CalibratedCamera* pose) const {
    Matrix7d normal = Matrix7d::Zero();
    for (int round = 0; round <= kRefinements; ++round) {
      normal.setZero();
      Vector7d gradient = Vector7d::Zero();
      const double wide = round < 4 ? 3.0 : 1.0;
      const auto add = [&](const auto& error, const auto& sight) {
        const Eigen::Vector2d e = error(*pose, sight);
        if (!(e.squaredNorm() < wide * wide * options_.gate_px * options_.gate_px)) return;
        Eigen::Matrix<double, 2, kParameters> J;
        for (int k = 0; k < kParameters; ++k) {
          Vector7d step = Vector7d::Zero();
          const double h = k >= 3 && k < 6 ? 1e-6 * pose->camera_from_scene.t.norm() : 1e-6;
          step(k) = h;
          J.col(k) =
              (error(Moved(*pose, step), sight) - error(Moved(*pose, -step), sight)) / (2 * h);
        }
        const double w = 1.0 / (1.0 + e.squaredNorm() / (kLossPx * kLossPx));
        normal += w * J.transpose() * J;
        gradient += w * J.transpose() * e;
      };
      for (const PointSight& s : points_) add(PointError, s);
      for (const LineSight& s : lines_) add(LineError, s);
      if (round == kRefinements) break;
      const double prior = (std::log(pose->camera.focal_px) - log_focal_) / log_sigma_;
      normal(6, 6) += 1.0 / (log_sigma_ * log_sigma_);
      gradient(6) += prior / log_sigma_;
      Matrix7d damped = normal;
      damped.diagonal() *= 1.0 + 1e-6;
      const Vector7d step = damped.ldlt().solve(-gradient);
      if (!step.allFinite()) break;
      *pose = Moved(*pose, step);
    }
    return normal;
  }

 private:
  std::span<const PointSight> points_;
  std::span<const LineSight> lines_;
  const ResectionOptions& options_;
  double log_focal_ = 0.0, log_sigma_ = 0.0;
};

std::vector<double> FocalLengths(const ImageSize& size,
                                 const ViewPrior& prior,
                                 const ResectionOptions& options) {
  if (prior.focal_px) return {*prior.focal_px};
  std::vector<double> out;
  const double ratio = options.max_focal_widths / options.min_focal_widths;
  for (int k = 0; k < options.focal_steps; ++k) {
    const double share = options.focal_steps > 1 ? k / (options.focal_steps - 1.0) : 0.5;
    out.push_back(options.min_focal_widths * size.width * std::pow(ratio, share));
  }
  return out;
}

// Real roots of a x^4 + ..., highest power first.
std::vector<double> RealRoots(const std::array<double, 5>& a) {
  if (!(std::abs(a[0]) > 1e-14)) return {};
  Eigen::Matrix4d companion = Eigen::Matrix4d::Zero();
  companion.bottomLeftCorner<3, 3>().setIdentity();
  for (int k = 0; k < 4; ++k) companion(0, k) = -a[k + 1] / a[0];
  if (!companion.allFinite()) return {};
  const Eigen::EigenSolver<Eigen::Matrix4d> solver(companion, false);
  std::vector<double> roots;
  for (const std::complex<double>& r : solver.eigenvalues()) {
    if (std::abs(r.imag()) < 1e-6 * (1.0 + std::abs(r.real()))) roots.push_back(r.real());
  }
  return roots;
}

// Rotation and translation that bring one triangle onto its congruent image.
std::optional<Rigid3> AlignTriangles(const std::array<Eigen::Vector3d, 3>& from,
                                     const std::array<Eigen::Vector3d, 3>& to) {
  const auto frame = [](const std::array<Eigen::Vector3d, 3>& p) -> std::optional<Eigen::Matrix3d> {
    const Eigen::Vector3d a = p[1] - p[0], n = a.cross(p[2] - p[0]);
    if (!(n.norm() > 1e-12 * a.squaredNorm())) return std::nullopt;
    Eigen::Matrix3d F;
    F.col(0) = a.normalized();
    F.col(2) = n.normalized();
    F.col(1) = F.col(2).cross(F.col(0));
    return F;
  };
  const auto A = frame(from), B = frame(to);
  if (!A || !B) return std::nullopt;
  Rigid3 out;
  out.R = *B * A->transpose();
  out.t = (to[0] + to[1] + to[2] - out.R * (from[0] + from[1] + from[2])) / 3.0;
  return out;
}

// The pose and focal length of three points that the others agree with best (RANSAC). Errors:
// CANCELLED.
absl::StatusOr<std::optional<CalibratedCamera>> DrawPose(const Problem& problem,
                                                         std::span<const PointSight> points,
                                                         const ImageSize& size,
                                                         const ViewPrior& prior,
                                                         const ResectionOptions& options,
                                                         const StopRequested& stop) {
  const int n = static_cast<int>(points.size());
  PinholeCamera given = CenteredCamera(size.width, size.height, 1.0);
  if (prior.principal_point_px) {
    given.cx = prior.principal_point_px->x();
    given.cy = prior.principal_point_px->y();
  }
  given.k1 = prior.k1.value_or(0.0);
  std::mt19937 rng(options.seed);
  std::optional<CalibratedCamera> best;
  double best_score = 1e300;
  const std::vector<double> focal_lengths = FocalLengths(size, prior, options);
  double needed = options.max_iterations;
  for (int i = 0; i < needed; ++i) {
    if (i % 64 == 0 && IsStopRequested(stop)) return absl::CancelledError("resection: cancelled");
    std::array<int, 3> chosen{};
    for (int k = 0; k < 3; ++k) {
      do {
        chosen[k] = static_cast<int>(rng() % static_cast<unsigned>(n));
      } while (std::find(chosen.begin(), chosen.begin() + k, chosen[k]) != chosen.begin() + k);
    }
    const std::array<Eigen::Vector3d, 3> X = {points[chosen[0]].point_in_world,
                                              points[chosen[1]].point_in_world,
                                              points[chosen[2]].point_in_world};
    for (const double focal_px : focal_lengths) {
      PinholeCamera camera = given;
      camera.focal_px = focal_px;
      std::array<Eigen::Vector3d, 3> rays;
      for (int k = 0; k < 3; ++k) {
        rays[k] = NormalizedPoint(camera, points[chosen[k]].pixel).homogeneous();
      }
      for (const Rigid3& camera_from_scene : PosesFromThreePoints(X, rays)) {
        const CalibratedCamera pose{camera, camera_from_scene};
        const double score = problem.Score(pose, best_score);
        if (score >= best_score) continue;
        best = pose, best_score = score;
        const double share = static_cast<double>(problem.Agreeing(pose)) / n;
        const double miss = std::log1p(-std::pow(share, 3));
        if (miss < 0.0) needed = std::min(needed, std::log(kMissed) / miss);
      }
    }
  }
  return best;
}

}  // namespace

std::vector<Rigid3> PosesFromThreePoints(std::span<const Eigen::Vector3d, 3> X,
                                         std::span<const Eigen::Vector3d, 3> directions) {
  const std::array<Eigen::Vector3d, 3> f = {
      directions[0].normalized(), directions[1].normalized(), directions[2].normalized()};
  const double a2 = (X[1] - X[2]).squaredNorm(), b2 = (X[0] - X[2]).squaredNorm(),
               c2 = (X[0] - X[1]).squaredNorm();
  if (!(b2 > 0.0) || !(a2 > 0.0) || !(c2 > 0.0)) return {};
  const double cos_a = f[1].dot(f[2]), cos_b = f[0].dot(f[2]), cos_c = f[0].dot(f[1]);
  // s2 = u s1, s3 = v s1; quartic in v (Haralick et al. 1994, eq. 9).
  const double q = (a2 - c2) / b2, p = (a2 + c2) / b2, ra = a2 / b2, rc = c2 / b2;
  const std::array<double, 5> quartic = {
      (q - 1.0) * (q - 1.0) - 4.0 * rc * cos_a * cos_a,
      4.0 * (q * (1.0 - q) * cos_b - (1.0 - p) * cos_a * cos_c + 2.0 * rc * cos_a * cos_a * cos_b),
      2.0 * (q * q - 1.0 + 2.0 * q * q * cos_b * cos_b + 2.0 * (1.0 - rc) * cos_a * cos_a -
             4.0 * p * cos_a * cos_b * cos_c + 2.0 * (1.0 - ra) * cos_c * cos_c),
      4.0 * (-q * (1.0 + q) * cos_b + 2.0 * ra * cos_c * cos_c * cos_b - (1.0 - p) * cos_a * cos_c),
      (1.0 + q) * (1.0 + q) - 4.0 * ra * cos_c * cos_c};
  std::vector<Rigid3> poses;
  for (const double v : RealRoots(quartic)) {
    const double below = 2.0 * (cos_c - v * cos_a);
    if (!(v > 0.0) || std::abs(below) < 1e-12) continue;
    const double u = ((q - 1.0) * v * v - 2.0 * q * cos_b * v + 1.0 + q) / below;
    const double s1_squared = b2 / (1.0 + v * v - 2.0 * v * cos_b);
    if (!(u > 0.0) || !(s1_squared > 0.0)) continue;
    const double s1 = std::sqrt(s1_squared);
    const auto pose = AlignTriangles({X[0], X[1], X[2]}, {s1 * f[0], u * s1 * f[1], v * s1 * f[2]});
    if (pose && pose->R.allFinite() && pose->t.allFinite()) poses.push_back(*pose);
  }
  return poses;
}

absl::StatusOr<ResectedCamera> ResectPinhole(std::span<const PointSight> points,
                                             std::span<const LineSight> lines,
                                             const ImageSize& size,
                                             const ViewPrior& prior,
                                             const ResectionOptions& options,
                                             const StopRequested& stop) {
  const int n = static_cast<int>(points.size());
  if (n < std::max(3, options.min_points)) {
    return absl::FailedPreconditionError(
        absl::StrFormat("%d known points matched, need %d", n, options.min_points));
  }
  const Problem problem(points, lines, size, prior, options);
  HOROPTER_ASSIGN_OR_RETURN(std::optional<CalibratedCamera> best,
                            DrawPose(problem, points, size, prior, options, stop));
  if (!best) return absl::FailedPreconditionError("no pose from any three points");
  const Matrix7d normal = problem.Refine(&*best);
  ResectedCamera out{*best};
  double squared = 0.0;
  for (const PointSight& s : points) {
    const double e2 = PointError(*best, s).squaredNorm();
    if (!(e2 < options.gate_px * options.gate_px)) continue;
    ++out.points;
    squared += e2;
  }
  for (const LineSight& s : lines) {
    out.lines += LineError(*best, s).cwiseAbs().maxCoeff() < options.gate_px;
  }
  if (out.points < options.min_points ||
      out.points + kLineWeight * out.lines < options.min_support) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "%d of %d points and %d of %d lines agree, need %d points and a support of %d",
        out.points,
        n,
        out.lines,
        static_cast<int>(lines.size()),
        options.min_points,
        options.min_support));
  }
  out.rms_px = std::sqrt(squared / (2.0 * out.points));
  out.focal_log_sigma = problem.FocalLogSigma(normal, std::max(out.rms_px, kMinSigmaPx));
  if (!(out.focal_log_sigma <= options.max_focal_log_sigma) ||
      !best->camera_from_scene.R.allFinite() || !best->camera_from_scene.t.allFinite()) {
    return absl::FailedPreconditionError(
        absl::StrFormat("focal length known to %.0f %%, need %.0f %%",
                        100.0 * std::min(out.focal_log_sigma, 10.0),
                        100.0 * options.max_focal_log_sigma));
  }
  const Eigen::Quaterniond rotation(best->camera_from_scene.R);
  out.camera_from_scene.R = rotation.normalized().toRotationMatrix();
  return out;
}

}  // namespace horopter
