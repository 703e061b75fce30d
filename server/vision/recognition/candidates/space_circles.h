// Circles in space: elliptic arcs that views with known cameras show at one place, of one radius
// and one attitude. One circle gives a turned part's pose but for the turn about its axis.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/recognition/candidates/space_corners.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

struct SpaceCircle {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();   // scene frame, metres
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit, towards the cameras
  double radius_m = 0.0;
  int views = 0;  // that show it
};

// Circles that two views or more show (circle_sighting.h), best shown first.
std::vector<SpaceCircle> FindSpaceCircles(std::span<const FeatureView> views,
                                          const SpaceCircleOptions& options = {});

}  // namespace horopter
