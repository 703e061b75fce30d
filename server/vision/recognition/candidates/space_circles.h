// Circles in space: elliptic arcs that views with known cameras show at one place, of one radius
// and one attitude. One circle gives a turned part's pose but for the turn about its axis.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/recognition/candidates/space_corners.h"

namespace horopter {

struct SpaceCircle {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();   // scene frame, metres
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit, towards the cameras
  double radius_m = 0.0;
  int views = 0;  // that show it
};

struct SpaceCircleOptions {
  double reach_px = 3.0;       // of an ellipse's centre from the projected one, working pixels
  double radius_log = 0.08;    // difference of the radii that views give
  double normal_rad = 0.25;    // ... and of the normals
  double min_sweep_rad = 1.6;  // shorter arcs say too little
  double min_minor_px = 2.5;   // working pixels
  double min_parallax_rad = 0.03;
  int max_circles = 150;  // those that most views show are kept
};

// Circles that two views or more show (circle_sighting.h), best shown first.
std::vector<SpaceCircle> FindSpaceCircles(std::span<const FeatureView> views,
                                          const SpaceCircleOptions& options = {});

}  // namespace horopter
