#include "server/vision/geometry/trifocal_tensor.h"

#include <Eigen/Dense>
#include <cmath>
#include <vector>

#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

constexpr double kDegenerateTensor = 1e-11;  // of squared singular values

using Vector27 = Eigen::Matrix<double, 27, 1>;  // T[i](j, k) at 9 i + 3 j + k
using Matrix27 = Eigen::MatrixXd;  // 27 x 27; of fixed size it takes a compiler twice as long

TrifocalTensor FromVector(const Vector27& t) {
  TrifocalTensor T;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T[i].row(j) = t.segment<3>(9 * i + 3 * j).transpose();
  }
  return T;
}

double Norm(const TrifocalTensor& T) {
  return std::sqrt(T[0].squaredNorm() + T[1].squaredNorm() + T[2].squaredNorm());
}

// [x2]x (sum x1_i T_i) [x3]x = 0.
void AddTriplet(const Triplet& x, Matrix27* moment) {
  const Eigen::Matrix3d left = CrossMatrix(x[1]), right = CrossMatrix(x[2]);
  for (int r = 0; r < 3; ++r) {
    for (int s = 0; s < 3; ++s) {
      Vector27 row;
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          row.segment<3>(9 * i + 3 * j) = x[0](i) * left(r, j) * right.col(s);
        }
      }
      *moment += row * row.transpose();
    }
  }
}

// l1 x (l2^T T_i l3) = 0.
void AddLineTriplet(const Triplet& l, Matrix27* moment) {
  const Eigen::Matrix3d cross = CrossMatrix(l[0]);
  for (int r = 0; r < 3; ++r) {
    Vector27 row;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) row.segment<3>(9 * i + 3 * j) = cross(r, i) * l[1](j) * l[2];
    }
    *moment += row * row.transpose();
  }
}

// Unit vector most perpendicular to the (left or right) null vectors of the three slices.
std::optional<Eigen::Vector3d> CommonPerpendicular(const TrifocalTensor& T, bool left) {
  Eigen::Matrix3d nulls;
  for (int i = 0; i < 3; ++i) {
    const Eigen::Matrix3d slice = left ? Eigen::Matrix3d(T[i].transpose()) : T[i];
    nulls.row(i) = EpipoleA(slice).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(nulls, Eigen::ComputeFullV);
  if (!nulls.allFinite() || svd.singularValues()(1) < 1e-9) return std::nullopt;
  return svd.matrixV().col(2);
}

// Similarity per view that brings points and the given lines to coordinates of order 1.
std::array<Eigen::Matrix3d, 3> Normalizations(std::span<const Triplet> points,
                                              std::span<const Triplet> lines) {
  std::array<Eigen::Matrix3d, 3> T;
  for (int v = 0; v < 3; ++v) {
    std::vector<Eigen::Vector2d> x;
    for (const Triplet& p : points) x.push_back(p[v].hnormalized());
    // The line's point nearest to the origin stands for it.
    for (const Triplet& l : lines) {
      x.push_back(-l[v].head<2>() * l[v].z() / l[v].head<2>().squaredNorm());
    }
    T[v] = NormalizingSimilarity(x);
  }
  return T;
}

// The same tensor in the coordinates before x_n = N_v x: lines go with N^T.
TrifocalTensor Denormalize(const TrifocalTensor& T, const std::array<Eigen::Matrix3d, 3>& N) {
  const Eigen::Matrix3d B = N[1].inverse(), C = N[2].inverse();
  TrifocalTensor out;
  for (int i = 0; i < 3; ++i) {
    out[i].setZero();
    for (int j = 0; j < 3; ++j) out[i] += N[0](j, i) * (B * T[j] * C.transpose());
  }
  const double norm = Norm(out);
  for (Eigen::Matrix3d& slice : out) slice /= norm;
  return out;
}

// min |A E a|, |E a| = 1 with T_i = a_i e3^T - e2 b_i^T.
std::optional<Vector27> ConstrainedMinimum(const Matrix27& moment,
                                           const Eigen::Vector3d& e2,
                                           const Eigen::Vector3d& e3) {
  Eigen::MatrixXd E = Eigen::MatrixXd::Zero(27, 18);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        E(9 * i + 3 * j + k, 3 * i + j) = e3(k);
        E(9 * i + 3 * j + k, 9 + 3 * i + k) = -e2(j);
      }
    }
  }
  const SymmetricEigen<Eigen::Dynamic> range(Eigen::MatrixXd{E * E.transpose()});
  const Eigen::MatrixXd U = range.eigenvectors().rightCols(15);  // E has rank 15
  const SymmetricEigen<Eigen::Dynamic> solver(Eigen::MatrixXd{U.transpose() * moment * U});
  if (solver.info() != Eigen::Success) return std::nullopt;
  return Vector27(U * solver.eigenvectors().col(0));
}

}  // namespace

TrifocalTensor TrifocalFromCameras(const CameraMatrix& P1,
                                   const CameraMatrix& P2,
                                   const CameraMatrix& P3) {
  TrifocalTensor T;
  for (int i = 0; i < 3; ++i) {
    Eigen::Matrix4d rows;
    rows.row(0) = P1.row((i + 1) % 3);
    rows.row(1) = P1.row((i + 2) % 3);
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        rows.row(2) = P2.row(j);
        rows.row(3) = P3.row(k);
        T[i](j, k) = rows.determinant();
      }
    }
  }
  const double norm = Norm(T);
  if (norm > 0.0) {
    for (Eigen::Matrix3d& slice : T) slice /= norm;
  }
  return T;
}

std::optional<std::array<CameraMatrix, 3>> CamerasFromTrifocal(const TrifocalTensor& T) {
  const auto e2 = CommonPerpendicular(T, true);
  const auto e3 = CommonPerpendicular(T, false);
  if (!e2 || !e3) return std::nullopt;
  std::array<CameraMatrix, 3> P;
  P[0].setZero();
  P[0].leftCols<3>().setIdentity();
  const Eigen::Matrix3d project = *e3 * e3->transpose() - Eigen::Matrix3d::Identity();
  for (int i = 0; i < 3; ++i) {
    P[1].col(i) = T[i] * *e3;
    P[2].col(i) = project * (T[i].transpose() * *e2);
  }
  P[1].col(3) = *e2;
  P[2].col(3) = *e3;
  return P;
}

Eigen::Vector3d TransferLine(const TrifocalTensor& T,
                             const Eigen::Vector3d& l2,
                             const Eigen::Vector3d& l3) {
  return {l2.dot(T[0] * l3), l2.dot(T[1] * l3), l2.dot(T[2] * l3)};
}

Eigen::Vector3d TransferPoint(const TrifocalTensor& T,
                              const Eigen::Vector3d& x1,
                              const Eigen::Vector3d& l2) {
  return (x1(0) * T[0] + x1(1) * T[1] + x1(2) * T[2]).transpose() * l2;
}

std::optional<TrifocalTensor> EstimateTrifocal(std::span<const Triplet> points,
                                               std::span<const Triplet> lines) {
  if (4 * points.size() + 2 * lines.size() < 26) return std::nullopt;
  const std::array<Eigen::Matrix3d, 3> N = Normalizations(points, lines);
  Matrix27 moment = Matrix27::Zero(27, 27);
  for (const Triplet& p : points) {
    Triplet x;
    for (int v = 0; v < 3; ++v) x[v] = (N[v] * p[v]).normalized();
    AddTriplet(x, &moment);
  }
  for (const Triplet& p : lines) {
    Triplet l;
    for (int v = 0; v < 3; ++v) l[v] = (N[v].inverse().transpose() * p[v]).normalized();
    AddLineTriplet(l, &moment);
  }
  if (!moment.allFinite()) return std::nullopt;
  const SymmetricEigen<Eigen::Dynamic> solver(moment);
  if (solver.info() != Eigen::Success ||
      solver.eigenvalues()(1) < kDegenerateTensor * solver.eigenvalues()(26)) {
    return std::nullopt;
  }
  const TrifocalTensor linear = FromVector(solver.eigenvectors().col(0));
  const auto e2 = CommonPerpendicular(linear, true);
  const auto e3 = CommonPerpendicular(linear, false);
  if (!e2 || !e3) return std::nullopt;
  const auto constrained = ConstrainedMinimum(moment, *e2, *e3);
  if (!constrained) return std::nullopt;
  return Denormalize(FromVector(*constrained), N);
}

}  // namespace horopter
