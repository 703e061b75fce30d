#include "server/vision/geometry/camera_factors.h"

#include <Eigen/Dense>
#include <cmath>

namespace horopter {

std::optional<CameraFactors> FactorCamera(const CameraMatrix& P) {
  constexpr double kSingular = 1e-14;  // determinant over the cube of the norm
  const Eigen::Matrix3d A = P.leftCols<3>();
  const double determinant = A.determinant();
  if (!P.allFinite() || !(std::abs(determinant) >= kSingular * std::pow(A.norm(), 3)) ||
      determinant == 0.0) {
    return std::nullopt;
  }
  const double sign = determinant < 0.0 ? -1.0 : 1.0;
  const Eigen::Matrix3d flip = Eigen::Matrix3d::Identity().rowwise().reverse();
  const Eigen::HouseholderQR<Eigen::Matrix3d> qr((flip * (sign * A)).transpose());
  CameraFactors out;
  Eigen::Matrix3d R = flip * Eigen::Matrix3d(qr.householderQ()).transpose();
  Eigen::Matrix3d K =
      flip * Eigen::Matrix3d(qr.matrixQR().triangularView<Eigen::Upper>()).transpose() * flip;
  for (int i = 0; i < 3; ++i) {
    if (K(i, i) >= 0.0) continue;
    K.col(i) *= -1.0;
    R.row(i) *= -1.0;
  }
  out.camera_from_scene = {R, K.triangularView<Eigen::Upper>().solve(sign * P.col(3))};
  out.K = K / K(2, 2);
  return out;
}

}  // namespace horopter
