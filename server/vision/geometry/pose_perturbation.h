// Small changes of rigid transforms and how they travel through products and inverses: what turns
// one covariance into that of another transform (thesis 5.4).
#pragma once

#include <Eigen/Core>

#include "server/vision/geometry/matrix6.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// exp of a rotation vector.
Eigen::Matrix3d RotationFromVector(const Eigen::Vector3d& w);

// One convention for every transform a_from_b = (R, t): the change d = (w, dt) makes it
// (exp(w) R, t + dt). w is a rotation vector about the axes of a through the origin of b (radians),
// dt is in a (metres).
Rigid3 Perturbed(const Rigid3& a_from_b, const Vector6d& d);

// d with `changed` = Perturbed(`pose`, d).
Vector6d PerturbationBetween(const Rigid3& pose, const Rigid3& changed);

// First order: the perturbation of a_from_b * b_from_c is FirstInProduct * d1 + SecondInProduct *
// d2, that of the inverse is InInverse * d.
Matrix6d FirstInProduct(const Rigid3& a_from_b, const Rigid3& b_from_c);
Matrix6d SecondInProduct(const Rigid3& a_from_b);
Matrix6d InInverse(const Rigid3& a_from_b);

// A transform with the covariance of its perturbation.
struct UncertainPose {
  Rigid3 pose;
  Matrix6d covariance = Matrix6d::Zero();
};

}  // namespace horopter
