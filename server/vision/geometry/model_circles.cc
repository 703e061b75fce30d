#include "server/vision/geometry/model_circles.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

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

std::vector<ModelCircle> LargeRims(const ObjectModel& model, double least_share, int most) {
  constexpr double kSameShare = 0.01;  // of the diameter: circles this alike are one
  const double same = kSameShare * model.diameter_m;
  std::vector<ModelCircle> circles = CirclesOf(model);
  std::erase_if(circles, [&](const ModelCircle& c) {
    return model.edges[c.edge].start_vertex >= 0 || c.radius_m < least_share * model.diameter_m;
  });
  std::stable_sort(circles.begin(), circles.end(), [](const ModelCircle& a, const ModelCircle& b) {
    return a.radius_m > b.radius_m;
  });
  std::vector<ModelCircle> out;
  for (const ModelCircle& c : circles) {
    if (static_cast<int>(out.size()) >= most) break;
    const bool known = std::any_of(out.begin(), out.end(), [&](const ModelCircle& o) {
      return (o.center - c.center).norm() < same && std::abs(o.radius_m - c.radius_m) < same;
    });
    if (!known) out.push_back(c);
  }
  return out;
}

}  // namespace horopter
