#include "server/vision/matching/homography.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

// Similarity that moves the points' centroid to the origin and their mean distance to sqrt(2)
// (Hartley 1997).
Eigen::Matrix3d NormalizingSimilarity(std::span<const PointPair> pairs,
                                      Eigen::Vector2d PointPair::*side) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const PointPair& p : pairs) mean += p.*side;
  mean /= static_cast<double>(pairs.size());
  double distance = 0.0;
  for (const PointPair& p : pairs) distance += (p.*side - mean).norm();
  distance /= static_cast<double>(pairs.size());
  const double s = distance > 1e-9 ? std::sqrt(2.0) / distance : 1.0;
  Eigen::Matrix3d T;
  T << s, 0, -s * mean.x(), 0, s, -s * mean.y(), 0, 0, 1;
  return T;
}

struct Spread {
  double long_px = 0.0;
  double short_px = 0.0;
};

Spread SpreadOf(std::span<const PointPair> pairs, Eigen::Vector2d PointPair::*side) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const PointPair& p : pairs) mean += p.*side;
  mean /= static_cast<double>(pairs.size());
  Eigen::Matrix2d C = Eigen::Matrix2d::Zero();
  for (const PointPair& p : pairs) C += (p.*side - mean) * (p.*side - mean).transpose();
  C /= static_cast<double>(pairs.size());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(C);
  return {std::sqrt(std::max(0.0, eigen.eigenvalues()(1))),
          std::sqrt(std::max(0.0, eigen.eigenvalues()(0)))};
}

double SquaredError(const Eigen::Matrix3d& H, std::span<const PointPair> pairs) {
  double sum = 0.0;
  for (const PointPair& p : pairs) sum += (p.b - Transfer(H, p.a)).squaredNorm();
  return sum;
}

}  // namespace

double SymmetricTransferError(const Eigen::Matrix3d& H,
                              const Eigen::Matrix3d& H_inverse,
                              const PointPair& pair) {
  const double forward = (pair.b - Transfer(H, pair.a)).norm();
  const double backward = (pair.a - Transfer(H_inverse, pair.b)).norm();
  // Written so that a NaN counts as infinitely far.
  const double worst = forward > backward ? forward : backward;
  return std::isfinite(forward) && std::isfinite(backward) ? worst : 1e30;
}

Eigen::Matrix2d TransferJacobian(const Eigen::Matrix3d& H, const Eigen::Vector2d& x) {
  const Eigen::Vector3d y = H * x.homogeneous();
  const Eigen::Vector2d p = y.head<2>() / y.z();
  return (H.topLeftCorner<2, 2>() - p * H.block<1, 2>(2, 0)) / y.z();
}

std::optional<Eigen::Matrix3d> NormalizeDeterminant(const Eigen::Matrix3d& H) {
  const double norm = H.norm();
  if (!std::isfinite(norm) || norm <= 0.0) return std::nullopt;
  const double det = (H / norm).determinant();
  if (std::abs(det) < 1e-30) return std::nullopt;
  return H / (norm * std::cbrt(det));
}

Eigen::Matrix3d RefineHomography(const Eigen::Matrix3d& H, std::span<const PointPair> pairs) {
  if (pairs.size() < 4) return H;
  const Eigen::Matrix3d Ta = NormalizingSimilarity(pairs, &PointPair::a);
  const Eigen::Matrix3d Tb = NormalizingSimilarity(pairs, &PointPair::b);
  std::vector<PointPair> q(pairs.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    q[i] = {Transfer(Ta, pairs[i].a), Transfer(Tb, pairs[i].b)};
  }
  Eigen::Matrix3d G = Tb * H * Ta.inverse();
  if (!G.allFinite() || std::abs(G(2, 2)) < 1e-12 * G.norm()) return H;
  G /= G(2, 2);
  double cost = SquaredError(G, q);
  if (!std::isfinite(cost)) return H;
  for (int iteration = 0; iteration < 10; ++iteration) {
    Eigen::Matrix<double, 8, 8> A = Eigen::Matrix<double, 8, 8>::Zero();
    Eigen::Matrix<double, 8, 1> g = Eigen::Matrix<double, 8, 1>::Zero();
    for (const PointPair& p : q) {
      const Eigen::Vector3d a = p.a.homogeneous();
      const Eigen::Vector3d y = G * a;
      const Eigen::Vector2d e = p.b - y.head<2>() / y.z();
      Eigen::Matrix<double, 2, 8> J = Eigen::Matrix<double, 2, 8>::Zero();
      J.block<1, 3>(0, 0) = a.transpose() / y.z();
      J.block<1, 3>(1, 3) = a.transpose() / y.z();
      J.block<2, 2>(0, 6) = -(y.head<2>() / (y.z() * y.z())) * p.a.transpose();
      A += J.transpose() * J;
      g += J.transpose() * e;
    }
    A.diagonal() *= 1.0 + 1e-9;
    const Eigen::Matrix<double, 8, 1> step = A.ldlt().solve(g);
    if (!step.allFinite()) break;
    Eigen::Matrix3d next = G;
    next.row(0) += step.head<3>().transpose();
    next.row(1) += step.segment<3>(3).transpose();
    next.block<1, 2>(2, 0) += step.tail<2>().transpose();
    const double next_cost = SquaredError(next, q);
    if (!(next_cost <= cost)) break;
    const bool converged = cost - next_cost < 1e-10 * cost;
    G = next;
    cost = next_cost;
    if (converged) break;
  }
  return NormalizeDeterminant(Tb.inverse() * G * Ta).value_or(H);
}

std::optional<Eigen::Matrix3d> FitHomography(std::span<const PointPair> pairs) {
  if (pairs.size() < 4) return std::nullopt;
  const Eigen::Matrix3d Ta = NormalizingSimilarity(pairs, &PointPair::a);
  const Eigen::Matrix3d Tb = NormalizingSimilarity(pairs, &PointPair::b);
  Eigen::Matrix<double, 9, 9> M = Eigen::Matrix<double, 9, 9>::Zero();
  for (const PointPair& p : pairs) {
    const Eigen::Vector3d a = Transfer(Ta, p.a).homogeneous();
    const Eigen::Vector2d b = Transfer(Tb, p.b);
    Eigen::Matrix<double, 2, 9> rows = Eigen::Matrix<double, 2, 9>::Zero();
    rows.block<1, 3>(0, 0) = a.transpose();
    rows.block<1, 3>(0, 6) = -b.x() * a.transpose();
    rows.block<1, 3>(1, 3) = a.transpose();
    rows.block<1, 3>(1, 6) = -b.y() * a.transpose();
    M += rows.transpose() * rows;
  }
  if (!M.allFinite()) return std::nullopt;
  const SymmetricEigen<9> eigen(M);
  // A second vanishing eigenvalue means a family of homographies.
  if (eigen.eigenvalues()(1) < 1e-12 * eigen.eigenvalues()(8)) return std::nullopt;
  const Eigen::Matrix<double, 9, 1> h = eigen.eigenvectors().col(0);
  Eigen::Matrix3d G;
  G.row(0) = h.head<3>().transpose();
  G.row(1) = h.segment<3>(3).transpose();
  G.row(2) = h.tail<3>().transpose();
  return NormalizeDeterminant(Tb.inverse() * G * Ta);
}

std::string ImplausibleHomography(const Eigen::Matrix3d& H,
                                  std::span<const PointPair> inliers,
                                  const HomographyLimits& limits) {
  if (inliers.size() < 4) return std::to_string(inliers.size()) + " inliers, need 4";
  const std::optional<Eigen::Matrix3d> normalized = NormalizeDeterminant(H);
  if (!normalized) return "singular";
  for (const PointPair& p : inliers) {
    // det 1 and w > 0 everywhere: the plane is seen from the same side, not mirrored, not behind a
    // camera.
    const double w = (*normalized * p.a.homogeneous()).z();
    if (!(w > 0.0)) return "mirrored or behind the camera";
    const double area = TransferJacobian(*normalized, p.a).determinant();
    if (!(area > 1.0 / limits.max_area_change && area < limits.max_area_change)) {
      return "area change " + std::to_string(area);
    }
  }
  for (const auto side : {&PointPair::a, &PointPair::b}) {
    const Spread spread = SpreadOf(inliers, side);
    if (spread.short_px <
        std::max(limits.min_spread_px, limits.min_spread_ratio * spread.long_px)) {
      return "inliers spread over " + std::to_string(spread.short_px) + " px only";
    }
  }
  return "";
}

}  // namespace horopter
