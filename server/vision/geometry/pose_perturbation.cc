#include "server/vision/geometry/pose_perturbation.h"

#include <Eigen/Geometry>

#include "server/vision/geometry/plucker_line.h"

namespace horopter {

Eigen::Matrix3d RotationFromVector(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  if (angle < 1e-12) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
}

Rigid3 Perturbed(const Rigid3& a_from_b, const Vector6d& d) {
  return {RotationFromVector(d.head<3>()) * a_from_b.R, a_from_b.t + d.tail<3>()};
}

Vector6d PerturbationBetween(const Rigid3& pose, const Rigid3& changed) {
  const Eigen::AngleAxisd turn(changed.R * pose.R.transpose());
  Vector6d d;
  d << turn.angle() * turn.axis(), changed.t - pose.t;
  return d;
}

// exp(w1) R1 exp(w2) R2 = exp(w1 + R1 w2) R1 R2 and
// exp(w1) R1 (t2 + dt2) + t1 + dt1 = t + w1 x R1 t2 + R1 dt2 + dt1.
Matrix6d FirstInProduct(const Rigid3& a_from_b, const Rigid3& b_from_c) {
  Matrix6d J = Matrix6d::Identity();
  J.bottomLeftCorner<3, 3>() = -CrossMatrix(a_from_b.R * b_from_c.t);
  return J;
}

Matrix6d SecondInProduct(const Rigid3& a_from_b) {
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = a_from_b.R;
  J.bottomRightCorner<3, 3>() = a_from_b.R;
  return J;
}

// (exp(w) R)^T = exp(-R^T w) R^T and -R^T exp(-w) (t + dt) = -R^T t + R^T (w x t) - R^T dt.
Matrix6d InInverse(const Rigid3& a_from_b) {
  const Eigen::Matrix3d Rt = a_from_b.R.transpose();
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = -Rt;
  J.bottomLeftCorner<3, 3>() = -Rt * CrossMatrix(a_from_b.t);
  J.bottomRightCorner<3, 3>() = -Rt;
  return J;
}

}  // namespace horopter
