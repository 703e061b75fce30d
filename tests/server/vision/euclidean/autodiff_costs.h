// The edge residual of the metric adjustment for automatic differentiation: what the analytic
// derivatives are held against. Parameters are increments about a base.
#pragma once

#include <ceres/rotation.h>

#include <Eigen/Core>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Camera block: rotation vector and translation increments (camera frame), log f, cx, cy, k1 (the
// last three absolute).
inline constexpr int kCameraBlock = 10;
// Object block: rotation vector about the scene axes through the object's origin, translation
// increment.
inline constexpr int kObjectBlock = 6;

template <typename T>
Eigen::Matrix<T, 3, 1> ToCamera(const T* camera,
                                const Rigid3& base,
                                const Eigen::Matrix<T, 3, 1>& point_in_scene) {
  const Eigen::Matrix<T, 3, 1> turned = base.R.cast<T>() * point_in_scene;
  Eigen::Matrix<T, 3, 1> out;
  ceres::AngleAxisRotatePoint(camera, turned.data(), out.data());
  for (int i = 0; i < 3; ++i) out[i] += T(base.t[i]) + camera[3 + i];
  return out;
}

template <typename T>
Eigen::Matrix<T, 2, 1> ToPixel(const T* camera, const Eigen::Matrix<T, 3, 1>& p) {
  const T x = p.x() / p.z(), y = p.y() / p.z();
  const T s = exp(camera[6]) * (T(1) + camera[9] * (x * x + y * y));
  return {s * x + camera[7], s * y + camera[8]};
}

// Signed distance of a projected CAD edge sample from the image edge point it was associated with,
// in sigmas.
struct EdgeCost {
  Eigen::Vector3d point_in_object;
  Rigid3 camera_from_scene;
  Rigid3 scene_from_object;
  Eigen::Vector2d edge_point;
  Eigen::Vector2d normal;
  double weight;

  template <typename T>
  bool operator()(const T* camera, const T* object, T* residual) const {
    const Eigen::Matrix<T, 3, 1> arm = (scene_from_object.R * point_in_object).cast<T>();
    Eigen::Matrix<T, 3, 1> in_scene;
    ceres::AngleAxisRotatePoint(object, arm.data(), in_scene.data());
    for (int i = 0; i < 3; ++i) in_scene[i] += T(scene_from_object.t[i]) + object[3 + i];
    const Eigen::Matrix<T, 3, 1> p = ToCamera(camera, camera_from_scene, in_scene);
    if (p.z() < T(1e-4)) return false;
    const Eigen::Matrix<T, 2, 1> u = ToPixel(camera, p);
    residual[0] = T(weight) * (T(normal.x()) * (u.x() - T(edge_point.x())) +
                               T(normal.y()) * (u.y() - T(edge_point.y())));
    return true;
  }
};

}  // namespace horopter
