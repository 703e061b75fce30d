#include "server/vision/reconstruction/intersection_resection.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

// Ratios of squared singular values below which a null vector is not unique.
constexpr double kSameRay = 1e-14;
constexpr double kAmbiguousCamera = 1e-13;

// The eigenvector of the smallest eigenvalue of a moment near `guess`, by inverse iteration: a
// fifth of the time of all eigenvectors. Nothing where a second one is as small or it does not
// settle; whoever asks then wants all of them.
template <int N>
std::optional<Eigen::Matrix<double, N, 1>> NullVectorNear(
    const Eigen::Matrix<double, N, N>& moment, const Eigen::Matrix<double, N, 1>& guess) {
  constexpr double kShift = 1e-14;    // of the trace: exact moments have no inverse
  constexpr double kSecond = 1e-9;    // of the trace: less may be a second null vector
  constexpr double kSettled = 1e-20;  // squared change
  constexpr int kIterations = 5;
  const double trace = moment.trace();
  Eigen::Matrix<double, N, N> shifted = moment;
  shifted.diagonal().array() += kShift * trace;
  const Eigen::LLT<Eigen::Matrix<double, N, N>> llt(shifted);
  if (llt.info() != Eigen::Success) return std::nullopt;
  Eigen::Matrix<double, N, 1> pivots = llt.matrixLLT().diagonal().cwiseAbs2();
  std::nth_element(pivots.data(), pivots.data() + 1, pivots.data() + N);
  if (!(pivots[1] > kSecond * trace)) return std::nullopt;
  Eigen::Matrix<double, N, 1> x = guess.normalized();
  for (int i = 0; i < kIterations; ++i) {
    Eigen::Matrix<double, N, 1> next = llt.solve(x).normalized();
    if (next.dot(x) < 0.0) next = -next;
    const double change = (next - x).squaredNorm();
    x = next;
    if (change < kSettled) return x;
  }
  return std::nullopt;
}

using Row12 = Eigen::Matrix<double, 12, 1>;
using Moment12 = Eigen::Matrix<double, 12, 12>;

// Observed image line, unit normal.
Eigen::Vector3d ObservedLine(const LineObservation& o) {
  const Eigen::Vector3d l = o.start.homogeneous().cross(o.end.homogeneous());
  return l / l.head<2>().norm();
}

std::optional<PluckerLine> LineOfPlanes(std::span<const WeightedLine> observations) {
  Eigen::Matrix4d moment = Eigen::Matrix4d::Zero();
  for (const WeightedLine& o : observations) {
    const Eigen::Vector4d plane = BackProjectLine(o.P, ObservedLine(*o.observation)).normalized();
    const double length = (o.observation->end - o.observation->start).norm();
    const double w = length / o.observation->sigma_px;  // inverse deviation of its direction
    moment += o.weight * w * w * plane * plane.transpose();
  }
  if (!moment.allFinite()) return std::nullopt;
  const SymmetricEigen<4> solver(moment);
  if (!(solver.eigenvalues()(2) > kSameRay * solver.eigenvalues()(3))) return std::nullopt;
  return JoinPoints(Eigen::Vector4d(solver.eigenvectors().col(0)),
                    Eigen::Vector4d(solver.eigenvectors().col(1)))
      .normalized();
}

// Point of the line seen at x: where it meets the plane through the camera's centre and the
// perpendicular of the observed line at x.
Eigen::Vector4d PointSeenAt(const CameraMatrix& P,
                            const PluckerLine& L,
                            const Eigen::Vector3d& observed,
                            const Eigen::Vector2d& x) {
  const Eigen::Vector2d along(-observed.y(), observed.x());
  const Eigen::Vector3d across(along.x(), along.y(), -along.dot(x));
  return MeetLinePlane(L, BackProjectLine(P, across));
}

void AddLineRows(const WeightedLine& line,
                 const std::optional<CameraMatrix>& previous,
                 Moment12* moment) {
  const LineObservation& o = *line.observation;
  const Eigen::Vector3d l = ObservedLine(o);
  std::array<Eigen::Vector4d, 2> on_line;
  if (previous) {
    on_line = {PointSeenAt(*previous, line.L, l, o.start),
               PointSeenAt(*previous, line.L, l, o.end)};
  } else {
    on_line = PointsOnLine(ToOrthonormal(line.L));
  }
  for (const Eigen::Vector4d& A : on_line) {
    const double depth = previous ? previous->row(2).dot(A) : 1.0;
    const double w = line.weight / (depth * depth * o.sigma_px * o.sigma_px);
    if (!std::isfinite(w)) continue;
    Row12 row;
    for (int r = 0; r < 3; ++r) row.segment<4>(4 * r) = l(r) * A;
    *moment += w * row * row.transpose();
  }
}

}  // namespace

std::optional<Eigen::Vector4d> IntersectPoint(std::span<const WeightedPoint> observations,
                                              const std::optional<Eigen::Vector4d>& previous) {
  Eigen::Matrix4d moment = Eigen::Matrix4d::Zero();
  for (const WeightedPoint& o : observations) {
    const double depth = previous ? o.P.row(2).dot(*previous) : o.P.row(2).norm();
    const double scale = depth * o.observation->sigma_px;
    const double w = o.weight / (scale * scale);
    if (!std::isfinite(w)) continue;
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector4d a = o.observation->pixel(k) * o.P.row(2) - o.P.row(k);
      moment += w * a * a.transpose();
    }
  }
  if (!moment.allFinite()) return std::nullopt;
  std::optional<Eigen::Vector4d> near;
  if (previous) near = NullVectorNear<4>(moment, *previous);
  if (!near) {
    const SymmetricEigen<4> solver(moment);
    if (!(solver.eigenvalues()(1) > kSameRay * solver.eigenvalues()(3))) return std::nullopt;
    near = solver.eigenvectors().col(0);
  }
  const Eigen::Vector4d& X = *near;
  double depths = 0.0;
  for (const WeightedPoint& o : observations) depths += o.P.row(2).dot(X) < 0.0 ? -1.0 : 1.0;
  return depths < 0.0 ? Eigen::Vector4d(-X) : X;
}

std::optional<PluckerLine> IntersectLine(std::span<const WeightedLine> observations,
                                         const std::optional<PluckerLine>& previous) {
  if (!previous || observations.size() < 3) return LineOfPlanes(observations);
  Matrix6d moment = Matrix6d::Zero();
  for (const WeightedLine& o : observations) {
    const LineCameraMatrix M = LineCamera(o.P);
    const double scale = (M * *previous).head<2>().norm() * o.observation->sigma_px;
    const double w = o.weight / (scale * scale);
    if (!std::isfinite(w)) continue;
    for (const Eigen::Vector2d& x : {o.observation->start, o.observation->end}) {
      const PluckerLine row = M.transpose() * x.homogeneous();
      moment += w * row * row.transpose();
    }
  }
  if (!moment.allFinite()) return std::nullopt;
  if (const auto near = NullVectorNear<6>(moment, *previous)) {
    return NearestLine(*near).normalized();
  }
  const SymmetricEigen<6> solver(moment);
  if (!(solver.eigenvalues()(1) > kSameRay * solver.eigenvalues()(5))) {
    return LineOfPlanes(observations);
  }
  return NearestLine(solver.eigenvectors().col(0)).normalized();
}

std::optional<CameraMatrix> ResectCamera(std::span<const WeightedPoint> points,
                                         std::span<const WeightedLine> lines,
                                         const std::optional<CameraMatrix>& previous) {
  if (2 * (points.size() + lines.size()) < 11) return std::nullopt;
  Moment12 moment = Moment12::Zero();
  for (const WeightedPoint& p : points) {
    const PointObservation& o = *p.observation;
    const double depth = previous ? previous->row(2).dot(p.X) : 1.0;
    const double w = p.weight / (depth * depth * o.sigma_px * o.sigma_px);
    if (!std::isfinite(w)) continue;
    // Blocks of the two rows (X, 0, -u X) and (0, X, -v X).
    const Eigen::Matrix4d XX = w * p.X * p.X.transpose();
    moment.block<4, 4>(0, 0) += XX;
    moment.block<4, 4>(4, 4) += XX;
    moment.block<4, 4>(8, 8) += o.pixel.squaredNorm() * XX;
    moment.block<4, 4>(8, 0) -= o.pixel.x() * XX;
    moment.block<4, 4>(8, 4) -= o.pixel.y() * XX;
    moment.block<4, 4>(0, 8) -= o.pixel.x() * XX;
    moment.block<4, 4>(4, 8) -= o.pixel.y() * XX;
  }
  for (const WeightedLine& line : lines) AddLineRows(line, previous, &moment);
  if (!moment.allFinite()) return std::nullopt;
  const SymmetricEigen<Eigen::Dynamic> solver(Eigen::MatrixXd{moment});
  if (!(solver.eigenvalues()(1) > kAmbiguousCamera * solver.eigenvalues()(11))) {
    return std::nullopt;
  }
  CameraMatrix P;
  for (int r = 0; r < 3; ++r) P.row(r) = solver.eigenvectors().col(0).segment<4>(4 * r).transpose();
  // Most points in front.
  double depths = 0.0;
  for (const WeightedPoint& p : points) depths += P.row(2).dot(p.X) < 0.0 ? -1.0 : 1.0;
  return depths < 0.0 ? CameraMatrix(-P) : P;
}

}  // namespace horopter
