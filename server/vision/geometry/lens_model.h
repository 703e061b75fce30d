// Lenses beyond one radial coefficient, as ROS's sensor_msgs/CameraInfo describes them.
#pragma once

#include <Eigen/Core>
#include <array>

namespace horopter {

// Pixels: the centre of the top-left pixel is (0, 0). coefficients of kPlumbBob: k1, k2, p1, p2, k3
// (Brown 1971, in the order of OpenCV), divided by 1 + k4 r^2 + k5 r^4 + k6 r^6 of denominator (0
// but for a rational lens); of kEquidistant: k1 .. k4 of the angle to the axis (Kannala and Brandt
// 2006).
struct LensModel {
  enum class Kind { kPlumbBob, kEquidistant };
  Kind kind = Kind::kPlumbBob;
  double fx = 1.0;
  double fy = 1.0;
  double cx = 0.0;
  double cy = 0.0;
  std::array<double, 5> coefficients{};
  std::array<double, 3> denominator{};
};

// Where a ray (x / z, y / z) of the camera frame meets the image.
Eigen::Vector2d DistortedPixel(const LensModel& lens, const Eigen::Vector2d& normalized);

// How far from the axis, in rays (tangent of the angle) and in the image (pixels over focal
// length), the lens can be believed: beyond `ray` the image folds back. Both are infinite where it
// does not, up to rays of 87 degrees. Of the radial part alone.
struct LensReach {
  double ray = 0.0;
  double image = 0.0;
};
LensReach ReachOf(const LensModel& lens);

// Whether the lens folds within an image of this size: its corners are where no ray is.
bool FoldsImage(const LensModel& lens, int width, int height);

}  // namespace horopter
