// Points, tangents and normals along an ellipse by its parameter.
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "server/vision/features/features.h"

namespace horopter {

// x(s) = center + axes (cos s, sin s): the columns of `axes` are the semi-axes in pixels. In the
// frame of `inverse` the ellipse is the unit circle.
struct EllipseFrame {
  explicit EllipseFrame(const EllipseArc& arc) : center(arc.center) {
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

  Eigen::Vector2d center;
  Eigen::Matrix2d axes;
  Eigen::Matrix2d inverse;
};

// (cos s, sin s).
inline Eigen::Vector2d UnitAt(double angle_rad) {
  return {std::cos(angle_rad), std::sin(angle_rad)};
}

}  // namespace horopter
