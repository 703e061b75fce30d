#include "server/vision/recognition/scoring/circle_sighting.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
std::optional<SightedCircle> SightCircle(const PinholeCamera& camera, const EllipseArc& arc) {
  SightedCircle s;
  s.ray = NormalizedPoint(camera, arc.center).homogeneous().normalized();
  s.radius_over_depth = arc.semi_major_px / camera.focal_px;
  Eigen::Vector3d minor(-std::sin(arc.angle_rad), std::cos(arc.angle_rad), 0.0);
  minor = (minor - minor.dot(s.ray) * s.ray).normalized();
  const double c = std::clamp(arc.semi_minor_px / arc.semi_major_px, 0.0, 1.0);
  const double slope = std::sqrt(1.0 - c * c);
  s.normal[0] = slope * minor - c * s.ray;
  s.normal[1] = -slope * minor - c * s.ray;
  if (!s.ray.allFinite() || !s.normal[0].allFinite()) return std::nullopt;
  return s;
}

Rigid3 PoseFromCircle(const ModelCircle& model,
                      const Eigen::Vector3d& center,
                      const Eigen::Vector3d& normal,
                      double turn_rad) {
  Rigid3 pose;
  pose.R = Eigen::AngleAxisd(turn_rad, normal) *
           Eigen::Quaterniond::FromTwoVectors(model.axis, normal).toRotationMatrix();
  pose.t = center - pose.R * model.center;
  return pose;
}

}  // namespace horopter
