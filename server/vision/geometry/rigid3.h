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

// A pose seen by a camera of another focal length: the depth scales with it, the image of the
// origin stays.
inline Rigid3 WithFocal(const Rigid3& camera_from_object, double old_focal, double new_focal) {
  Rigid3 out = camera_from_object;
  out.t.z() *= new_focal / old_focal;
  return out;
}

}  // namespace horopter
