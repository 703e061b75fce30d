// Minimal parameters of homogeneous quantities.
#pragma once

#include <Eigen/Dense>

namespace horopter {

// Orthonormal basis of what is orthogonal to x != 0: in which directions a homogeneous vector
// moves.
template <int N>
Eigen::Matrix<double, N, N - 1> SphereTangent(const Eigen::Matrix<double, N, 1>& x) {
  // Householder vector u of x -> -sign(x0) |x| e0; the other columns of I - 2 u u^T / u^T u.
  Eigen::Matrix<double, N, 1> u = x;
  u(0) += x(0) < 0.0 ? -x.norm() : x.norm();
  Eigen::Matrix<double, N, N - 1> basis = -(2.0 / u.squaredNorm()) * u * u.tail(N - 1).transpose();
  for (int k = 0; k < N - 1; ++k) basis(k + 1, k) += 1.0;
  return basis;
}

// A line as two orthonormal points A, B of R^4 on the Grassmannian Gr(2, 4): A and B move within
// the complement N of their span, X <- X + N D with D of 2 x 2 (four parameters, column after
// column). Unlike (d; m) it has no singular place: lines at infinity and through the origin are as
// good as others.
using LineSpan = Eigen::Matrix<double, 4, 2>;

inline LineSpan LineComplement(const LineSpan& X) {
  const Eigen::HouseholderQR<LineSpan> qr(X);
  const Eigen::Matrix4d Q = qr.householderQ();
  return Q.rightCols<2>();
}

inline LineSpan MoveLine(const LineSpan& X, const Eigen::Vector4d& step) {
  const Eigen::Map<const Eigen::Matrix2d> D(step.data());
  LineSpan Y = X + LineComplement(X) * D;
  // Gram-Schmidt keeps A and B orthonormal; the span is what counts.
  Y.col(0).normalize();
  Y.col(1) -= Y.col(0) * Y.col(0).dot(Y.col(1));
  Y.col(1).normalize();
  return Y;
}

}  // namespace horopter
