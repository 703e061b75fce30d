// Ceres cost functors of the metric bundle adjustment. Parameters are increments about a base that
// the solver's caller folds in after each round, so that covariances are left perturbations at the
// solution.
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

// Transfer of a matched point of the supporting plane m.(X - anchor) = -1 (scene frame) from view a
// to view b, in sigmas. The anchor lies off the plane (the mean camera centre does).
struct PlanePointCost {
  Rigid3 a_from_scene;
  Rigid3 b_from_scene;
  Eigen::Vector3d anchor;
  Eigen::Vector2d pixel_a;
  Eigen::Vector2d pixel_b;
  double weight;

  template <typename T>
  bool operator()(const T* camera_a, const T* camera_b, const T* plane, T* residual) const {
    const T f = exp(camera_a[6]);
    T x = (T(pixel_a.x()) - camera_a[7]) / f, y = (T(pixel_a.y()) - camera_a[8]) / f;
    const T undistort = T(1) - camera_a[9] * (x * x + y * y);  // first order, k1 r^2 << 1
    Eigen::Matrix<T, 3, 1> ray(x * undistort, y * undistort, T(1));
    // Scene ray: p = R^T exp(-w) (z ray - t).
    const T inverse[3] = {-camera_a[0], -camera_a[1], -camera_a[2]};
    Eigen::Matrix<T, 3, 1> t, direction, origin;
    for (int i = 0; i < 3; ++i) t[i] = T(a_from_scene.t[i]) + camera_a[3 + i];
    ceres::AngleAxisRotatePoint(inverse, ray.data(), direction.data());
    ceres::AngleAxisRotatePoint(inverse, t.data(), origin.data());
    direction = a_from_scene.R.transpose().cast<T>() * direction;
    origin = -(a_from_scene.R.transpose().cast<T>() * origin);
    const Eigen::Matrix<T, 3, 1> m(plane[0], plane[1], plane[2]);
    const T denominator = m.dot(direction);
    if (denominator == T(0)) return false;
    const T z = (T(-1) - m.dot(origin - anchor.cast<T>())) / denominator;
    if (z < T(1e-4)) return false;
    const Eigen::Matrix<T, 3, 1> p = ToCamera<T>(camera_b, b_from_scene, origin + z * direction);
    if (p.z() < T(1e-4)) return false;
    const Eigen::Matrix<T, 2, 1> u = ToPixel(camera_b, p);
    residual[0] = T(weight) * (u.x() - T(pixel_b.x()));
    residual[1] = T(weight) * (u.y() - T(pixel_b.y()));
    return true;
  }
};

// Priors on log f, cx, cy, k1.
struct CameraPrior {
  double log_focal, cx, cy, k1;
  double log_focal_sigma, center_sigma_px, k1_sigma;

  template <typename T>
  bool operator()(const T* camera, T* residual) const {
    residual[0] = (camera[6] - T(log_focal)) / T(log_focal_sigma);
    residual[1] = (camera[7] - T(cx)) / T(center_sigma_px);
    residual[2] = (camera[8] - T(cy)) / T(center_sigma_px);
    residual[3] = (camera[9] - T(k1)) / T(k1_sigma);
    return true;
  }
};

}  // namespace horopter
