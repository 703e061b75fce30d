// Pose and focal length of one more view from points and lines that other views gave.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/reconstruction/image_size.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

// A known point or line with where the view sees it (pixels).
struct PointSight {
  Eigen::Vector3d point_in_world = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
};
struct LineSight {
  PluckerLine line_in_world = PluckerLine::Zero();
  Eigen::Vector2d start = Eigen::Vector2d::Zero();
  Eigen::Vector2d end = Eigen::Vector2d::Zero();
};

// k1 and principal point as given, else 0 and the centre.
struct ResectedCamera : CalibratedCamera {
  int points = 0, lines = 0;     // that agree
  double rms_px = 0.0;           // of these points, per coordinate
  double focal_log_sigma = 0.0;  // posterior, for a world that is exact
};

// Up to four poses of a camera that sees three points along the given directions (any length):
// Grunert's quartic as in Haralick et al. (1994). Empty when the points are collinear.
std::vector<Rigid3> PosesFromThreePoints(std::span<const Eigen::Vector3d, 3> points_in_world,
                                         std::span<const Eigen::Vector3d, 3> directions_in_camera);

// RANSAC over three points and a grid of focal lengths, refined on points and lines with a robust
// loss. Errors: FAILED_PRECONDITION with numbers (too little agrees, the focal length stays open),
// CANCELLED.
absl::StatusOr<ResectedCamera> ResectPinhole(std::span<const PointSight> points,
                                             std::span<const LineSight> lines,
                                             const ImageSize& size,
                                             const ViewPrior& prior,
                                             const ResectionOptions& options,
                                             const StopRequested& stop = {});

}  // namespace horopter
