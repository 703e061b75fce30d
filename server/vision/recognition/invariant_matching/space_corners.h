// Corners in space: junctions that several views with known cameras show at one point, with the
// directions of their edges. One corner with two edges gives a part's whole pose, standing or not.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/geometry/calibrated_camera.h"

namespace horopter {

struct SpaceCornerOptions {
  double reach_px = 2.5;        // of a junction from the projected point, working pixels
  double direction_rad = 0.09;  // of an image edge from the projected direction
  double min_parallax_rad = 0.03;
  double same_point_m = 0.003;  // nearer corners are one
};

// A view whose camera is known. The scene frame is any metric frame.
struct FeatureView : CalibratedCamera {
  const ImageFeatures* features = nullptr;
  double working_from_image = 1.0;
};

// A feature by its index in an image; view: index into the views that were searched.
struct ShownFeature {
  int view = -1;
  int feature = -1;
};

struct SpaceCorner {
  struct Edge {
    Eigen::Vector3d direction = Eigen::Vector3d::UnitX();  // unit, away from the corner
    double length_m = 0.0;  // the longest that any view shows; the model edge is not shorter
    std::vector<ShownFeature> segments;  // of the views that agree about it
  };
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // scene frame, metres
  std::vector<Edge> edges;                          // two at least
  std::vector<ShownFeature> junctions;              // that show the point, one a view

  int views() const { return static_cast<int>(junctions.size()); }
};

// Corners that three views show (two where there are only two), best shown first. Directions are
// confirmed by as many views. Lens distortion bends no edge noticeably over its length.
std::vector<SpaceCorner> FindSpaceCorners(std::span<const FeatureView> views,
                                          const SpaceCornerOptions& options = {});

}  // namespace horopter
