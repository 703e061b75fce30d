// Circles and ellipses in space from their images in views whose cameras are known (thesis 3.3).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"

namespace horopter {

// An ellipse in a plane of space; a circle where `circle`.
struct SpaceConic {
  Rigid3 scene_from_conic;  // its centre; x, y along the semi-axes, z the plane's normal
  double semi_major = 0.0;  // in the scene's unit
  double semi_minor = 0.0;
  bool circle = false;
  // Of the turn (radians, in the conic's frame), the centre (scene frame) and the logarithms of the
  // semi-axes. A circle's turn about its normal is no parameter (0), and its two axes are one.
  Eigen::Matrix<double, 8, 8> covariance = Eigen::Matrix<double, 8, 8>::Zero();
  double rms_px = 0.0;  // of the points from its images
};

// Points of one conic in one image, pixels; on whatever share of it was seen, six at least.
struct ConicSight {
  CalibratedCamera view;
  std::vector<Eigen::Vector2d> points;
};

struct SpaceConicOptions {
  // Of a point across the curve, independent of the others; it is not less than the fit says.
  double sigma_px = 0.4;
  // What a circle fits to is no ellipse, and what an ellipse does not fit to is no plane conic.
  double max_rms_px = 1.0;
};

// The circle with least squared distances from its images to the points; two sights at least, the
// cameras count as exact. Starts: the two circles that the first two images show each alone, at the
// depth at which their centres meet. Nothing where no such circle is before all cameras, where it
// is seen from its own plane, or without parallax.
std::optional<SpaceConic> FitSpaceCircle(std::span<const ConicSight> sights,
                                         const SpaceConicOptions& options = {});

// The same of an ellipse; three sights at least, as two cones meet in two of them. Starts: the
// planes of the degenerate member of the pencils of the first three viewing cones (Quan 1996).
std::optional<SpaceConic> FitSpaceEllipse(std::span<const ConicSight> sights,
                                          const SpaceConicOptions& options = {});

// A circle where one fits to max_rms_px, else an ellipse where one does.
std::optional<SpaceConic> FitSpaceConic(std::span<const ConicSight> sights,
                                        const SpaceConicOptions& options = {});

// First-order distances of pixels from the conic's image, signed: outside positive. The lens's
// bending is undone at the pixels. Not finite from a view in its plane.
std::vector<double> DistancesToImage(const SpaceConic& conic, const ConicSight& sight);

// A point of the conic by its parameter, scene frame.
Eigen::Vector3d PointOfConic(const SpaceConic& conic, double angle_rad);

}  // namespace horopter
