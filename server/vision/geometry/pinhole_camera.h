// Pinhole camera with square pixels, zero skew and one radial coefficient.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace horopter {

// Pixels: the centre of the top-left pixel is (0, 0), x right, y down. Camera frame: z forward
// (OpenCV). u = focal_px * x_d / z + cx with the normalised point x scaled by (1 + k1 r^2).
struct PinholeCamera {
  int width = 0;
  int height = 0;
  double focal_px = 0.0;
  double cx = 0.0;
  double cy = 0.0;
  double k1 = 0.0;

  Eigen::Matrix3d K() const {
    Eigen::Matrix3d k;
    k << focal_px, 0, cx, 0, focal_px, cy, 0, 0, 1;
    return k;
  }
};

// A camera looking along z with its principal point in the image centre and no distortion.
inline PinholeCamera CenteredCamera(int width, int height, double focal_px) {
  return {width, height, focal_px, 0.5 * (width - 1), 0.5 * (height - 1), 0.0};
}

// Projects a point given in the camera frame (metres) to pixels. Points with z <= 0 have no
// meaningful image; the caller checks z.
inline Eigen::Vector2d Project(const PinholeCamera& camera,
                               const Eigen::Vector3d& point_in_camera) {
  const Eigen::Vector2d n = point_in_camera.head<2>() / point_in_camera.z();
  const double d = 1.0 + camera.k1 * n.squaredNorm();
  return {camera.focal_px * d * n.x() + camera.cx, camera.focal_px * d * n.y() + camera.cy};
}

// The normalised image point (x / z, y / z) of a pixel, lens distortion undone (fixed point, five
// rounds: exact to 1e-6 px for |k1| <= 0.3 inside the image).
inline Eigen::Vector2d NormalizedPoint(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d d((pixel.x() - camera.cx) / camera.focal_px,
                          (pixel.y() - camera.cy) / camera.focal_px);
  Eigen::Vector2d n = d;
  if (camera.k1 == 0.0) return n;
  for (int i = 0; i < 5; ++i) n = d / (1.0 + camera.k1 * n.squaredNorm());
  return n;
}

}  // namespace horopter
