#include "server/vision/euclidean/view_jacobian.h"

#include <cmath>

#include "server/vision/geometry/plucker_line.h"

namespace horopter {

double CauchyLoss(double sigmas, double squared) {
  const double c2 = sigmas * sigmas;
  return c2 * std::log1p(squared / c2);
}

double RobustWeight(double sigmas, double squared) {
  return 1.0 / (1.0 + squared / (sigmas * sigmas));
}

Eigen::Vector2d ProjectWithJacobian(const PinholeCamera& camera,
                                    const Eigen::Vector3d& p,
                                    const Eigen::Vector3d& arm,
                                    Eigen::Matrix<double, 2, 3>* by_point,
                                    ViewJacobian* by_view) {
  const Eigen::Vector2d n = p.head<2>() / p.z();
  const double squared = n.squaredNorm(), d = 1.0 + camera.k1 * squared;
  const Eigen::Vector2d off = camera.focal_px * d * n;
  const Eigen::Matrix2d by_n =
      camera.focal_px * (d * Eigen::Matrix2d::Identity() + 2.0 * camera.k1 * n * n.transpose());
  Eigen::Matrix<double, 2, 3> n_by_p;
  n_by_p << 1.0, 0.0, -n.x(), 0.0, 1.0, -n.y();
  *by_point = by_n * n_by_p / p.z();
  by_view->leftCols<3>() = -*by_point * CrossMatrix(arm);
  by_view->middleCols<3>(3) = *by_point;
  by_view->col(6) = off;
  by_view->middleCols<2>(7) = Eigen::Matrix2d::Identity();
  by_view->col(9) = camera.focal_px * squared * n;
  return off + Eigen::Vector2d(camera.cx, camera.cy);
}

}  // namespace horopter
