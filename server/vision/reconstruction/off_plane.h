// What stands off the plane that things stand on: groups of points in space, with a box in space
// and one in each image, where a part may be looked for more closely.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/image_regions.h"
#include "server/vision/geometry/supporting_plane.h"
#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// A point of texture, a corner, or one of an edge's (PointsOfEdge), in the frame of the cameras.
struct SpacePoint {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

// Lengths are shares of the cameras' mean distance from the points, whatever the frame's unit.
struct OffPlaneOptions {
  // A point stands off the plane beyond this height and three of its deviations. Lower: the plane's
  // own unevenness comes in.
  double least_height = 0.012;
  // Points are of one thing when nearer than this to one another. Larger: neighbours grow together.
  double gap = 0.06;
  int min_points = 6;  // of a group; fewer may be wrong matches
  int max_groups = 12;
  // By which a box is grown all around, as a share of its largest side: points lie inside of what
  // they are of.
  double margin = 0.15;
  double max_size = 0.7;  // of a box's longest side; larger ones are background: a wall
};

struct OffPlaneGroup {
  std::vector<int> points;  // indices of those given
  // From the plane up to the highest point, along its footprint's longer and shorter direction; z
  // of its frame is the plane's normal. Grown by the margin and two deviations of the points at its
  // border. Its unit is the frame's.
  SpaceBox box;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();  // of the points
  // Of the middle: the points' mean covariance, as their cameras' errors are common to them.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  std::vector<std::optional<ImageBox>> images;  // one per view; empty: not seen there
};

// The points of a reconstruction with their covariances under its cameras, which count as exact;
// those of fewer than two registered views or without parallax are left out. sigma_px: of a sight.
std::vector<SpacePoint> PointsInSpace(std::span<const ReconstructedPoint> points,
                                      std::span<const std::optional<CalibratedView>> views,
                                      double sigma_px = 1.0);

// Points along an edge in space, its ends among them, at most `step` apart (> 0; at most 100).
std::vector<SpacePoint> PointsOfEdge(const SpacePoint& start, const SpacePoint& end, double step);

// Groups of those above the plane (on the side of its normal), the ones of most points first. The
// plane, points and views are of one frame. None without views, or where nothing stands off.
std::vector<OffPlaneGroup> FindOffPlane(std::span<const SpacePoint> points,
                                        const SupportingPlane& plane,
                                        std::span<const std::optional<CalibratedView>> views,
                                        const OffPlaneOptions& options = {});

}  // namespace horopter
