#include "server/vision/geometry/fundamental_matrix.h"

#include <Eigen/Dense>
#include <cmath>
#include <numbers>

#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

// A second null vector of the linear system: the points determine no single F.
constexpr double kDegenerateEpipolar = 1e-10;

using Row9 = Eigen::Matrix<double, 1, 9>;  // F row by row

Row9 EpipolarRow(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const Eigen::Vector3d x = a.homogeneous(), y = b.homogeneous();
  Row9 row;
  for (int r = 0; r < 3; ++r) row.segment<3>(3 * r) = y(r) * x.transpose();
  return row;
}

Eigen::Matrix3d FromRow(const Eigen::Matrix<double, 9, 1>& f) {
  Eigen::Matrix3d F;
  for (int r = 0; r < 3; ++r) F.row(r) = f.segment<3>(3 * r).transpose();
  return F;
}

Eigen::Matrix3d EnforceRankTwo(const Eigen::Matrix3d& F) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d s = svd.singularValues();
  s(2) = 0.0;
  return svd.matrixU() * s.asDiagonal() * svd.matrixV().transpose();
}

// Real roots of c3 x^3 + c2 x^2 + c1 x + c0, each polished by Newton.
std::vector<double> CubicRoots(double c3, double c2, double c1, double c0) {
  const double scale = std::max({std::abs(c3), std::abs(c2), std::abs(c1), std::abs(c0)});
  std::vector<double> roots;
  if (!(scale > 0.0)) return roots;
  if (std::abs(c3) < 1e-13 * scale) {
    const double disc = c1 * c1 - 4.0 * c2 * c0;
    if (std::abs(c2) < 1e-13 * scale) {
      if (std::abs(c1) > 1e-13 * scale) roots.push_back(-c0 / c1);
    } else if (disc >= 0.0) {
      const double q = -0.5 * (c1 + std::copysign(std::sqrt(disc), c1));
      roots.push_back(q / c2);
      if (q != 0.0) roots.push_back(c0 / q);
    }
  } else {
    const double a = c2 / c3, b = c1 / c3, c = c0 / c3;
    const double Q = (a * a - 3.0 * b) / 9.0, R = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0;
    if (R * R < Q * Q * Q) {
      const double theta = std::acos(R / std::sqrt(Q * Q * Q));
      for (int k = -1; k <= 1; ++k) {
        roots.push_back(-2.0 * std::sqrt(Q) * std::cos((theta + 2.0 * std::numbers::pi * k) / 3.0) -
                        a / 3.0);
      }
    } else {
      const double A = -std::copysign(std::cbrt(std::abs(R) + std::sqrt(R * R - Q * Q * Q)), R);
      roots.push_back(A + (A != 0.0 ? Q / A : 0.0) - a / 3.0);
    }
  }
  for (double& x : roots) {
    for (int i = 0; i < 2; ++i) {
      const double slope = (3.0 * c3 * x + 2.0 * c2) * x + c1;
      if (slope != 0.0) x -= (((c3 * x + c2) * x + c1) * x + c0) / slope;
    }
  }
  return roots;
}

}  // namespace

Eigen::Matrix3d FundamentalFromCameras(const CameraMatrix& P_a, const CameraMatrix& P_b) {
  const Eigen::Vector3d e = P_b * CameraCenter(P_a).normalized();
  const Eigen::Matrix<double, 4, 3> inverse = P_a.transpose() * (P_a * P_a.transpose()).inverse();
  const Eigen::Matrix3d F = CrossMatrix(e) * P_b * inverse;
  const double norm = F.norm();
  return norm > 0.0 ? Eigen::Matrix3d(F / norm) : F;
}

Eigen::Vector3d EpipoleA(const Eigen::Matrix3d& F) {
  return Eigen::JacobiSVD<Eigen::Matrix3d>(F, Eigen::ComputeFullV).matrixV().col(2);
}

Eigen::Vector3d EpipoleB(const Eigen::Matrix3d& F) {
  return EpipoleA(F.transpose());
}

std::array<CameraMatrix, 2> CamerasFromFundamental(const Eigen::Matrix3d& F) {
  const Eigen::Vector3d e = EpipoleB(F);
  CameraMatrix first = CameraMatrix::Zero(), second;
  first.leftCols<3>().setIdentity();
  second << CrossMatrix(e) * (F / F.norm()), e;
  return {first, second};
}

Eigen::Matrix3d NormalizingSimilarity(std::span<const Eigen::Vector2d> points) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : points) mean += p;
  mean /= std::max<double>(1.0, static_cast<double>(points.size()));
  double squared = 0.0;
  for (const Eigen::Vector2d& p : points) squared += (p - mean).squaredNorm();
  if (!(squared > 0.0)) return Eigen::Matrix3d::Identity();
  const double s = std::sqrt(2.0 * static_cast<double>(points.size()) / squared);
  Eigen::Matrix3d T;
  T << s, 0, -s * mean.x(), 0, s, -s * mean.y(), 0, 0, 1;
  return T;
}

std::optional<Eigen::Matrix3d> EightPoint(std::span<const Eigen::Vector2d> a,
                                          std::span<const Eigen::Vector2d> b) {
  if (a.size() != b.size() || a.size() < 8) return std::nullopt;
  const Eigen::Matrix3d Ta = NormalizingSimilarity(a), Tb = NormalizingSimilarity(b);
  Eigen::MatrixXd A(static_cast<Eigen::Index>(a.size()), 9);
  for (size_t k = 0; k < a.size(); ++k) {
    A.row(static_cast<Eigen::Index>(k)) =
        EpipolarRow((Ta * a[k].homogeneous()).head<2>(), (Tb * b[k].homogeneous()).head<2>());
  }
  if (!A.allFinite()) return std::nullopt;
  const Eigen::Matrix<double, 9, 9> moment = A.transpose() * A;
  const SymmetricEigen<9> solver(moment);
  if (solver.info() != Eigen::Success ||
      solver.eigenvalues()(1) < kDegenerateEpipolar * solver.eigenvalues()(8)) {
    return std::nullopt;
  }
  const Eigen::Matrix3d F =
      Tb.transpose() * EnforceRankTwo(FromRow(solver.eigenvectors().col(0))) * Ta;
  return F / F.norm();
}

std::vector<Eigen::Matrix3d> SevenPoint(std::span<const Eigen::Vector2d, 7> a,
                                        std::span<const Eigen::Vector2d, 7> b) {
  const Eigen::Matrix3d Ta = NormalizingSimilarity(a), Tb = NormalizingSimilarity(b);
  Eigen::Matrix<double, 9, 7> At;
  for (int k = 0; k < 7; ++k) {
    At.col(k) =
        EpipolarRow((Ta * a[k].homogeneous()).head<2>(), (Tb * b[k].homogeneous()).head<2>())
            .transpose();
  }
  // The null space is what an orthogonal decomposition of the rows leaves over.
  const Eigen::ColPivHouseholderQR<Eigen::Matrix<double, 9, 7>> qr(At);
  if (!At.allFinite() || qr.rank() < 7) return {};
  const Eigen::Matrix<double, 9, 9> Q = qr.householderQ();
  const Eigen::Matrix3d F1 = FromRow(Q.col(7)), F2 = FromRow(Q.col(8));
  // det(F1 + x F2) by its values at four places.
  const double d0 = F1.determinant(), d3 = F2.determinant();
  const double plus = (F1 + F2).determinant(), minus = (F1 - F2).determinant();
  const double d2 = 0.5 * (plus + minus) - d0, d1 = 0.5 * (plus - minus) - d3;
  std::vector<Eigen::Matrix3d> out;
  for (const double x : CubicRoots(d3, d2, d1, d0)) {
    const Eigen::Matrix3d F = Tb.transpose() * (F1 + x * F2) * Ta;
    if (F.allFinite() && F.norm() > 0.0) out.push_back(F / F.norm());
  }
  return out;
}

double SampsonSquared(const Eigen::Matrix3d& F,
                      const Eigen::Vector2d& a,
                      const Eigen::Vector2d& b) {
  const Eigen::Vector3d x = a.homogeneous(), y = b.homogeneous();
  const Eigen::Vector3d Fx = F * x, Fy = F.transpose() * y;
  const double e = y.dot(Fx);
  return e * e / (Fx.head<2>().squaredNorm() + Fy.head<2>().squaredNorm());
}

}  // namespace horopter
