#include "server/vision/geometry/collineation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

constexpr double kDegenerate = 1e-9;  // relative singular value: the points lie in a plane
constexpr int kRefineRounds = 50;     // Levenberg-Marquardt steps at most

using Row16 = Eigen::Matrix<double, 1, 16>;  // H row by row
using Moment16 = Eigen::Matrix<double, 16, 16>;

void AddPoint(const PointPair3& pair, Moment16* moment) {
  const Eigen::Vector4d x = pair.from.normalized(), y = pair.to.normalized();
  for (int a = 0; a < 4; ++a) {
    for (int b = a + 1; b < 4; ++b) {
      Row16 row = Row16::Zero();
      row.segment<4>(4 * b) = y(a) * x.transpose();
      row.segment<4>(4 * a) = -y(b) * x.transpose();
      *moment += row.transpose() * row;
    }
  }
}

void AddLine(const LinePair3& pair, Moment16* moment) {
  const Eigen::Matrix4d dual = DualPluckerMatrix(pair.to.normalized());
  const Eigen::Matrix4d lambda = PluckerMatrix(pair.from.normalized());
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) {
      Row16 row;
      for (int i = 0; i < 4; ++i) row.segment<4>(4 * i) = dual(r, i) * lambda.col(c).transpose();
      *moment += row.transpose() * row;
    }
  }
}

Eigen::Vector3d Residual(const Eigen::Matrix4d& H, const PointPair3& pair) {
  const Eigen::Vector4d y = H * pair.from;
  return y.head<3>() / y.w() - pair.to.head<3>() / pair.to.w();
}

}  // namespace

Eigen::Vector4d MapPoint(const Eigen::Matrix4d& H, const Eigen::Vector4d& point) {
  return H * point;
}

Eigen::Vector4d MapPlane(const Eigen::Matrix4d& H, const Eigen::Vector4d& plane) {
  return H.inverse().transpose() * plane;
}

PluckerLine MapLine(const Eigen::Matrix4d& H, const PluckerLine& line) {
  return LineOfMatrix(H * PluckerMatrix(line) * H.transpose());
}

Matrix6d LineCollineation(const Eigen::Matrix4d& H) {
  Matrix6d out;
  for (int k = 0; k < 6; ++k) out.col(k) = MapLine(H, PluckerLine::Unit(k));
  return out;
}

std::optional<Eigen::Matrix4d> FitCollineation(std::span<const PointPair3> points,
                                               std::span<const LinePair3> lines) {
  Moment16 moment = Moment16::Zero();
  for (const PointPair3& pair : points) AddPoint(pair, &moment);
  for (const LinePair3& pair : lines) AddLine(pair, &moment);
  if (!moment.allFinite()) return std::nullopt;
  const SymmetricEigen<Eigen::Dynamic> solver(Eigen::MatrixXd{moment});
  // Eigenvalues are squares of singular values.
  if (solver.info() != Eigen::Success ||
      solver.eigenvalues()(1) <= kDegenerate * kDegenerate * 1e4 * solver.eigenvalues()(15)) {
    return std::nullopt;
  }
  Eigen::Matrix4d H;
  for (int r = 0; r < 4; ++r) {
    H.row(r) = solver.eigenvectors().col(0).segment<4>(4 * r).transpose();
  }
  return H;
}

double CollineationRms(const Eigen::Matrix4d& H, std::span<const PointPair3> points) {
  if (points.empty()) return 0.0;
  double sum = 0.0;
  for (const PointPair3& pair : points) sum += Residual(H, pair).squaredNorm();
  return std::sqrt(sum / static_cast<double>(points.size()));
}

Eigen::Matrix4d RefineCollineation(const Eigen::Matrix4d& H, std::span<const PointPair3> points) {
  Eigen::Matrix4d best = H / H.norm();
  double cost = CollineationRms(best, points);
  double lambda = 1e-4;
  for (int round = 0; round < kRefineRounds && std::isfinite(cost) && lambda < 1e8; ++round) {
    Moment16 N = Moment16::Zero();
    Eigen::Matrix<double, 16, 1> g = Eigen::Matrix<double, 16, 1>::Zero();
    for (const PointPair3& pair : points) {
      const Eigen::Vector4d y = best * pair.from;
      const Eigen::Vector3d e = Residual(best, pair);
      for (int k = 0; k < 3; ++k) {
        Row16 row = Row16::Zero();
        row.segment<4>(4 * k) = pair.from.transpose() / y.w();
        row.segment<4>(12) = -pair.from.transpose() * (y(k) / (y.w() * y.w()));
        N += row.transpose() * row;
        g += row.transpose() * e(k);
      }
    }
    N.diagonal() *= 1.0 + lambda;
    N.diagonal().array() += 1e-12 * N.diagonal().maxCoeff();  // the scale of H is free
    const Eigen::Matrix<double, 16, 1> step = N.ldlt().solve(-g);
    Eigen::Matrix4d next = best;
    for (int r = 0; r < 4; ++r) next.row(r) += step.segment<4>(4 * r).transpose();
    next /= next.norm();
    const double next_cost = CollineationRms(next, points);
    if (next_cost < cost) {
      const bool done = cost - next_cost < 1e-10 * cost;
      best = next;
      cost = next_cost;
      lambda = std::max(1e-10, lambda * 0.2);
      if (done) break;
    } else {
      lambda *= 10.0;
    }
  }
  return best;
}

}  // namespace horopter
