// What an elliptic arc says of the circle that it shows.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/geometry/model_circles.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Weak perspective about the arc's centre: minor / major is the cosine of the angle between the
// circle's normal and the ray, and the minor axis lies along the normal's image. The centre's image
// is taken for the ellipse's centre: of a circle seen from ten radii off by less than 1 % of its
// radius. Camera frame.
struct SightedCircle {
  Eigen::Vector3d ray = Eigen::Vector3d::UnitZ();  // unit, from the eye to the centre
  double radius_over_depth = 0.0;
  std::array<Eigen::Vector3d, 2> normal;  // unit, towards the eye; seen alone it may be either
};

// Empty where the arc lies outside of what the lens model can undistort.
std::optional<SightedCircle> SightCircle(const PinholeCamera& camera, const EllipseArc& arc);

// Pose that brings the model circle to (center, normal), turned by `turn_rad` about the normal from
// some attitude; normal and center in one frame, which the pose leads to.
Rigid3 PoseFromCircle(const ModelCircle& model,
                      const Eigen::Vector3d& center,
                      const Eigen::Vector3d& normal,
                      double turn_rad);

}  // namespace horopter
