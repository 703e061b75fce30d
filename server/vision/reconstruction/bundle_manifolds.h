// Minimal parameters of homogeneous quantities for Ceres, and the residuals both bundle
// adjustments share.
#pragma once

#include <ceres/loss_function.h>
#include <ceres/manifold.h>
#include <ceres/problem.h>

#include <Eigen/Dense>
#include <vector>

#include "server/vision/reconstruction/robust_loss.h"

namespace horopter {

// A line as two orthonormal points A, B of R^4 (ambient 8, column after column) on the
// Grassmannian Gr(2, 4): tangent 4, A and B move within the complement N of their span. Unlike
// (d; m) it has no singular place: lines at infinity and through the origin are as good as others.
class GrassmannLine final : public ceres::Manifold {
 public:
  static constexpr int kAmbient = 8;
  static constexpr int kTangent = 4;
  using Span = Eigen::Matrix<double, 4, 2>;

  int AmbientSize() const override { return kAmbient; }
  int TangentSize() const override { return kTangent; }

  bool Plus(const double* x, const double* delta, double* out) const override {
    const Eigen::Map<const Span> X(x);
    const Span N = Complement(X);
    const Eigen::Map<const Eigen::Matrix2d> D(delta);
    Span Y = X + N * D;
    // Gram-Schmidt keeps A and B orthonormal; the span is what counts.
    Y.col(0).normalize();
    Y.col(1) -= Y.col(0) * Y.col(0).dot(Y.col(1));
    Y.col(1).normalize();
    Eigen::Map<Span>{out} = Y;
    return Y.allFinite();
  }

  bool PlusJacobian(const double* x, double* jacobian) const override {
    const Eigen::Map<const Span> X(x);
    const Span N = Complement(X);
    Eigen::Map<Eigen::Matrix<double, kAmbient, kTangent, Eigen::RowMajor>> J(jacobian);
    J.setZero();
    J.topLeftCorner<4, 2>() = N;
    J.bottomRightCorner<4, 2>() = N;
    return true;
  }

  bool Minus(const double* y, const double* x, double* delta) const override {
    const Eigen::Map<const Span> Y(y), X(x);
    const Span N = Complement(X);
    const Eigen::Matrix2d inside = X.transpose() * Y;
    Eigen::Map<Eigen::Matrix2d>{delta} = N.transpose() * Y * inside.inverse();
    return true;
  }

  bool MinusJacobian(const double* x, double* jacobian) const override {
    const Eigen::Map<const Span> X(x);
    const Span N = Complement(X);
    Eigen::Map<Eigen::Matrix<double, kTangent, kAmbient, Eigen::RowMajor>> J(jacobian);
    J.setZero();
    J.topLeftCorner<2, 4>() = N.transpose();
    J.bottomRightCorner<2, 4>() = N.transpose();
    return true;
  }

 private:
  // Orthonormal basis of what X leaves.
  static Span Complement(const Span& X) {
    const Eigen::HouseholderQR<Span> qr(X);
    const Eigen::Matrix4d Q = qr.householderQ();
    return Q.rightCols<2>();
  }
};

// The loss as Ceres has it (of squared residuals); nullptr for kNone.
inline ceres::LossFunction* MakeCeresLoss(RobustLoss loss, double scale) {
  const double c = scale * TuningConstant(loss);
  switch (loss) {
    case RobustLoss::kTukey:
      return new ceres::TukeyLoss(c);
    case RobustLoss::kCauchy:
      return new ceres::CauchyLoss(c);
    case RobustLoss::kHuber:
      return new ceres::HuberLoss(c);
    case RobustLoss::kNone:
      break;
  }
  return nullptr;
}

// Sets one manifold for all blocks that the problem has. Takes ownership, also when none has it.
template <typename Manifold, typename Block>
void SetSharedManifold(Manifold* manifold, std::vector<Block>* blocks, ceres::Problem* problem) {
  bool used = false;
  for (Block& block : *blocks) {
    if (!problem->HasParameterBlock(block.data())) continue;
    problem->SetManifold(block.data(), manifold);
    used = true;
  }
  if (!used) delete manifold;
}

}  // namespace horopter
