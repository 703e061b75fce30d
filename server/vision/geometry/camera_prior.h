// What is known of a camera before its images are looked at.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "server/vision/geometry/pinhole_camera.h"

namespace horopter {

// What the caller happens to know about a camera. Unset fields are unknown.
struct CameraHint {
  std::optional<double> focal_px;
  std::optional<double> focal_log_sigma;  // default kHintedFocalLogSigma when focal_px is given
  std::optional<Eigen::Vector2d> principal_point;
  // Deviation of each of its coordinates, about the point given or the middle of the image; pixels.
  std::optional<double> principal_point_sigma_px;
  std::optional<double> k1;
  // The focal length is what the image's file says, which may have been edited: who took the image
  // said nothing.
  bool presumed = false;
};

// Deviation of ln f about a focal length that is known and whose deviation is not: two per cent, of
// lenses whose focal length is read off them, and of the distance they are focused at.
inline constexpr double kHintedFocalLogSigma = 0.02;

// A focal length nobody knows, in image widths, and the deviation of its logarithm: from wrist
// cameras that see 90 degrees (0.5) over webcams and telephones (0.7 - 1) to machine vision's
// lenses (1.2 - 2.5). 0.95 and 0.5, which hold all of these, were tried: see "Nominal focal length"
// in tests/bench/history/photographs.md.
inline constexpr double kNominalFocalShare = 1.2;
inline constexpr double kNominalFocalLogSigma = 0.35;

inline double FocalLogSigma(const CameraHint& hint) {
  return hint.focal_log_sigma.value_or(kHintedFocalLogSigma);
}

// A camera with what is known of it in place of what was supposed.
inline PinholeCamera WithHint(PinholeCamera camera, const CameraHint& hint) {
  if (hint.focal_px) camera.focal_px = *hint.focal_px;
  if (hint.principal_point) {
    camera.cx = hint.principal_point->x();
    camera.cy = hint.principal_point->y();
  }
  if (hint.k1) camera.k1 = *hint.k1;
  return camera;
}

}  // namespace horopter
