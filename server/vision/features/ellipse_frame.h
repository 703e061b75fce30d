// Points, tangents and normals along an ellipse by its parameter.
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "server/vision/features/features.h"

namespace horopter {

// x(s) = center + axes (cos s, sin s): the columns of `axes` are the semi-axes in pixels. In the
// frame of `inverse` the ellipse is the unit circle.
struct EllipseFrame {
  explicit EllipseFrame(const EllipseArc& arc)
      : center(arc.center), semi_major(arc.semi_major_px), semi_minor(arc.semi_minor_px) {
    const double c = std::cos(arc.angle_rad), s = std::sin(arc.angle_rad);
    axes << c * arc.semi_major_px, -s * arc.semi_minor_px,  //
        s * arc.semi_major_px, c * arc.semi_minor_px;
    inverse << c / arc.semi_major_px, s / arc.semi_major_px,  //
        -s / arc.semi_minor_px, c / arc.semi_minor_px;
  }

  // `unit` is (cos s, sin s).
  Eigen::Vector2d PointAt(const Eigen::Vector2d& unit) const { return center + axes * unit; }
  // dx/ds, pixels.
  Eigen::Vector2d DerivativeAt(const Eigen::Vector2d& unit) const {
    return axes * Eigen::Vector2d(-unit.y(), unit.x());
  }
  // Outwards, of length one.
  Eigen::Vector2d NormalAt(const Eigen::Vector2d& unit) const {
    return (inverse.transpose() * unit).normalized();
  }

  // Parameter s of the point in whose direction from the centre `point` lies, (-pi, pi].
  double AngleOf(const Eigen::Vector2d& point) const {
    const Eigen::Vector2d u = inverse * (point - center);
    return std::atan2(u.y(), u.x());
  }
  // First-order distance of a point from the whole ellipse, pixels.
  double DistanceOf(const Eigen::Vector2d& point) const {
    const Eigen::Vector2d u = inverse * (point - center);
    const double radius = u.norm();
    if (radius < 1e-9) return semi_minor;
    // g = radius - 1 is homogeneous of degree one, so g / |grad g| is accurate near the curve.
    const double slope = Eigen::Vector2d(u.x() / semi_major, u.y() / semi_minor).norm() / radius;
    return std::abs(radius - 1.0) / slope;
  }

  Eigen::Vector2d center;
  double semi_major, semi_minor;
  Eigen::Matrix2d axes;
  Eigen::Matrix2d inverse;
};

// (cos s, sin s).
inline Eigen::Vector2d UnitAt(double angle_rad) {
  return {std::cos(angle_rad), std::sin(angle_rad)};
}

}  // namespace horopter
