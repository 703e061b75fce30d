// Rigid transform of 3-space.
#pragma once

#include <Eigen/Core>

namespace horopter {

// x_a = R x_b + t for a transform named a_from_b. R is a proper rotation; t in metres.
struct Rigid3 {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();

  Rigid3 Inverse() const { return {R.transpose(), -(R.transpose() * t)}; }
};

inline Rigid3 operator*(const Rigid3& a_from_b, const Rigid3& b_from_c) {
  return {a_from_b.R * b_from_c.R, a_from_b.R * b_from_c.t + a_from_b.t};
}

inline Eigen::Vector3d operator*(const Rigid3& a_from_b, const Eigen::Vector3d& point_in_b) {
  return a_from_b.R * point_in_b + a_from_b.t;
}

}  // namespace horopter
