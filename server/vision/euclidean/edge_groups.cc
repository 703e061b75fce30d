#include "server/vision/euclidean/edge_groups.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <tuple>
#include <utility>

#include "server/vision/euclidean/representative.h"
#include "server/vision/euclidean/robust_scatter.h"

namespace horopter {
namespace {

// Position along the edge by the principal direction of the points, and the line through the
// residuals.
void FitGroup(const std::vector<Eigen::Vector3d>& positions, EdgeGroup* group) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& p : positions) middle += p / static_cast<double>(positions.size());
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  for (const auto& p : positions) moment += (p - middle) * (p - middle).transpose();
  const Eigen::Vector3d along =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(moment).eigenvectors().col(2);
  double reach = 1e-9;
  for (const auto& p : positions) reach = std::max(reach, std::abs(along.dot(p - middle)));
  Eigen::Matrix2d A = 1e-9 * Eigen::Matrix2d::Identity();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
  for (std::size_t i = 0; i < positions.size(); ++i) {
    EdgeGroup::Point& p = group->points[i];
    p.at = along.dot(positions[i] - middle) / reach;
    const Eigen::Vector2d x(1.0, p.at);
    A += p.weight * x * x.transpose();
    b += p.weight * p.residual * x;
  }
  if (positions.size() < 3) {
    group->mean = b(0) / A(0, 0);
    return;
  }
  const Eigen::Vector2d line = A.ldlt().solve(b);
  group->mean = line(0);
  group->tilt = line(1);
}

// Removes what a turn about an axis of revolution does: facets and chords that stand for a round
// surface would seem to determine it. Rotation by a about the axis through the object's point p is
// the perturbation (a, -a x R p).
void ForgetTurn(const AdjustedObject& object, const RevolutionAxis& revolution, EdgeRow* row) {
  const Eigen::Matrix3d& R = object.scene_from_object.R;
  const Eigen::Vector3d a = R * revolution.axis;
  auto J = row->J.segment<6>(kViewParameters);
  const double along = J.head<3>().dot(a) - J.tail<3>().dot(a.cross(R * revolution.point));
  J.head<3>() -= along * a;
}

}  // namespace

std::vector<EdgeGroup> GroupEdges(const SceneBundle& bundle) {
  std::vector<std::optional<RevolutionAxis>> axes;
  for (const AdjustedObject& o : bundle.objects) {
    axes.push_back(FindRevolutionAxis(o.model->model));
  }
  std::map<std::tuple<int, int, int>, std::pair<EdgeGroup, std::vector<Eigen::Vector3d>>> groups;
  for (const EdgeObservation& o : bundle.edges) {
    EdgeGroup::Point point;
    if (!LinearizeEdge(bundle, o, &point.row)) continue;
    if (axes[o.object]) ForgetTurn(bundle.objects[o.object], *axes[o.object], &point.row);
    point.weight = RobustWeight(bundle.cauchy_sigmas, point.row.residual * point.row.residual);
    point.shared = SharedSamples(o.spacing_px);
    point.unit = 1.0 / (bundle.edge_sigma_px * std::sqrt(point.shared));
    point.residual = point.row.residual / point.unit;
    auto& [group, positions] = groups[{o.view, o.object, o.edge}];
    group.view = o.view;
    group.object = o.object;
    group.edge = o.edge;
    group.points.push_back(point);
    positions.push_back(o.point_in_object);
  }
  std::vector<EdgeGroup> out;
  for (auto& [key, value] : groups) {
    FitGroup(value.second, &value.first);
    out.push_back(std::move(value.first));
  }
  return out;
}

}  // namespace horopter
