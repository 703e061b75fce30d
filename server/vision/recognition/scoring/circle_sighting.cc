#include "server/vision/recognition/scoring/circle_sighting.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Through the first point and two that lie a third of the polyline apart.
std::optional<ModelCircle> CircleOf(const ModelEdge& edge) {
  if (edge.kind != CurveKind::kCircle || edge.polyline.size() < 4) return std::nullopt;
  const std::size_t last = edge.polyline.size() - 1;
  const Eigen::Vector3d& p = edge.polyline[0];
  const Eigen::Vector3d a = edge.polyline[last / 3] - p, b = edge.polyline[2 * last / 3] - p;
  const Eigen::Vector3d cross = a.cross(b);
  if (!(cross.norm() > 1e-6 * a.norm() * b.norm())) return std::nullopt;
  const Eigen::Vector3d to_center =
      (a.squaredNorm() * b.cross(cross) + b.squaredNorm() * cross.cross(a)) /
      (2.0 * cross.squaredNorm());
  return ModelCircle{p + to_center, cross.normalized(), to_center.norm()};
}

}  // namespace

std::vector<ModelCircle> CirclesOf(const ObjectModel& model) {
  std::vector<ModelCircle> circles;
  for (std::size_t e = 0; e < model.edges.size(); ++e) {
    std::optional<ModelCircle> circle = CircleOf(model.edges[e]);
    if (!circle) continue;
    circle->edge = static_cast<int>(e);
    circles.push_back(*circle);
  }
  return circles;
}

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
