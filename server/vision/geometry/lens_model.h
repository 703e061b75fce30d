// Lenses beyond one radial coefficient, as ROS's sensor_msgs/CameraInfo describes them.
#pragma once

#include <Eigen/Core>
#include <array>

namespace horopter {

// Pixels: the centre of the top-left pixel is (0, 0). coefficients of kPlumbBob: k1, k2, p1, p2, k3
// (Brown 1971, in the order of OpenCV); of kEquidistant: k1 .. k4 of the angle to the axis (Kannala
// and Brandt 2006).
struct LensModel {
  enum class Kind { kPlumbBob, kEquidistant };
  Kind kind = Kind::kPlumbBob;
  double fx = 1.0;
  double fy = 1.0;
  double cx = 0.0;
  double cy = 0.0;
  std::array<double, 5> coefficients{};
};

// Where a ray (x / z, y / z) of the camera frame meets the image.
Eigen::Vector2d DistortedPixel(const LensModel& lens, const Eigen::Vector2d& normalized);

}  // namespace horopter
