#include "server/vision/reconstruction/off_plane.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace horopter {
namespace {

constexpr double kHeightDeviations = 3.0;
constexpr double kBoxDeviations = 2.0;
constexpr double kMinInformation = 1e-9;  // share of the largest; less: no parallax
constexpr int kMaxPointsOfEdge = 100;

Eigen::Matrix<double, 2, 3> ProjectionByPoint(const CalibratedView& view,
                                              const Eigen::Vector3d& in_camera) {
  const double f = view.camera.focal_px / in_camera.z();
  Eigen::Matrix<double, 2, 3> J;
  J << f, 0.0, -f * in_camera.x() / in_camera.z(), 0.0, f, -f * in_camera.y() / in_camera.z();
  return J * view.camera_from_scene.R;
}

double MeanDistance(std::span<const SpacePoint> points,
                    std::span<const std::optional<CalibratedView>> views) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const SpacePoint& p : points) middle += p.point / static_cast<double>(points.size());
  double sum = 0.0;
  int count = 0;
  for (const auto& view : views) {
    if (!view) continue;
    sum += (view->camera_from_scene.Inverse().t - middle).norm();
    ++count;
  }
  return count > 0 ? sum / count : 0.0;
}

// Points nearer than the gap to one another, directly or through others.
std::vector<std::vector<int>> Clusters(std::span<const SpacePoint> points,
                                       const std::vector<int>& among,
                                       double gap) {
  std::vector<std::vector<int>> clusters;
  std::vector<int> left = among;
  while (!left.empty()) {
    std::vector<int> cluster = {left.back()};
    left.pop_back();
    for (std::size_t next = 0; next < cluster.size(); ++next) {
      const Eigen::Vector3d from = points[cluster[next]].point;
      const auto near = std::partition(
          left.begin(), left.end(), [&](int i) { return (points[i].point - from).norm() > gap; });
      cluster.insert(cluster.end(), near, left.end());
      left.erase(near, left.end());
    }
    std::sort(cluster.begin(), cluster.end());
    clusters.push_back(std::move(cluster));
  }
  std::sort(clusters.begin(), clusters.end(), [](const auto& a, const auto& b) {
    return a.size() != b.size() ? a.size() > b.size() : a < b;
  });
  return clusters;
}

// Axes of the footprint of the points, the plane's normal as third.
Eigen::Matrix3d FootprintAxes(std::span<const SpacePoint> points,
                              const std::vector<int>& of,
                              const Eigen::Vector3d& middle,
                              const Eigen::Vector3d& normal) {
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int i : of) {
    Eigen::Vector3d along = points[i].point - middle;
    along -= normal.dot(along) * normal;
    scatter += along * along.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  Eigen::Vector3d x = eigen.eigenvectors().col(2);
  x -= normal.dot(x) * normal;
  if (!(x.norm() > 0.5)) x = normal.unitOrthogonal();
  Eigen::Matrix3d axes;
  axes.col(0) = x.normalized();
  axes.col(1) = normal.cross(axes.col(0));
  axes.col(2) = normal;
  return axes;
}

OffPlaneGroup GroupOf(std::span<const SpacePoint> points,
                      std::vector<int> of,
                      const SupportingPlane& plane,
                      double margin) {
  OffPlaneGroup group;
  const auto n = static_cast<double>(of.size());
  for (const int i : of) {
    group.middle += points[i].point / n;
    group.covariance += points[i].covariance / n;
  }
  const Eigen::Matrix3d axes = FootprintAxes(points, of, group.middle, plane.normal);
  Eigen::AlignedBox3d box;
  for (const int i : of) {
    const Eigen::Vector3d at = axes.transpose() * points[i].point;
    const Eigen::Vector3d deviation =
        (axes.transpose() * points[i].covariance * axes).diagonal().cwiseMax(0.0).cwiseSqrt();
    box.extend(at - kBoxDeviations * deviation);
    box.extend(at + kBoxDeviations * deviation);
  }
  box.min().z() = plane.offset_m;
  const Eigen::Vector3d grown = Eigen::Vector3d::Constant(margin * box.sizes().maxCoeff());
  box.max() += grown;
  box.min().head<2>() -= grown.head<2>();
  group.box.base_from_box = {axes, axes * box.center()};
  group.box.size_m = box.sizes();
  group.points = std::move(of);
  return group;
}

}  // namespace

std::vector<SpacePoint> PointsInSpace(std::span<const ReconstructedPoint> points,
                                      std::span<const std::optional<CalibratedView>> views,
                                      double sigma_px) {
  std::vector<SpacePoint> out;
  for (const ReconstructedPoint& point : points) {
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    for (const auto& [v, feature] : point.observations) {
      if (!views[v]) continue;
      const Eigen::Vector3d in_camera = views[v]->camera_from_scene * point.point_in_world;
      if (!(in_camera.z() > 0.0)) continue;
      const auto J = ProjectionByPoint(*views[v], in_camera);
      information += J.transpose() * J / (sigma_px * sigma_px);
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(information);
    if (!(eigen.eigenvalues()(0) > kMinInformation * eigen.eigenvalues()(2))) continue;
    out.push_back({point.point_in_world, information.inverse()});
  }
  return out;
}

std::vector<SpacePoint> PointsOfEdge(const SpacePoint& start, const SpacePoint& end, double step) {
  const double length = (end.point - start.point).norm();
  const int pieces = std::clamp(
      static_cast<int>(std::ceil(std::min(length / step, 1e6))), 1, kMaxPointsOfEdge - 1);
  std::vector<SpacePoint> out;
  for (int k = 0; k <= pieces; ++k) {
    const double s = static_cast<double>(k) / pieces;
    out.push_back({(1.0 - s) * start.point + s * end.point,
                   (1.0 - s) * start.covariance + s * end.covariance});
  }
  return out;
}

std::vector<OffPlaneGroup> FindOffPlane(std::span<const SpacePoint> points,
                                        const SupportingPlane& plane,
                                        std::span<const std::optional<CalibratedView>> views,
                                        const OffPlaneOptions& options) {
  const double unit = MeanDistance(points, views);
  std::vector<int> off;
  for (int i = 0; i < std::ssize(points); ++i) {
    const double height = plane.normal.dot(points[i].point) - plane.offset_m;
    const double deviation =
        std::sqrt(std::max(0.0, plane.normal.dot(points[i].covariance * plane.normal)));
    if (height > options.least_height * unit && height > kHeightDeviations * deviation)
      off.push_back(i);
  }
  std::vector<OffPlaneGroup> groups;
  for (std::vector<int>& cluster : Clusters(points, off, options.gap * unit)) {
    if (std::ssize(cluster) < options.min_points || std::ssize(groups) >= options.max_groups) break;
    OffPlaneGroup group = GroupOf(points, std::move(cluster), plane, options.margin);
    if (group.box.size_m.maxCoeff() > options.max_size * unit) continue;
    for (const auto& view : views) {
      group.images.emplace_back();
      if (view) group.images.back() = BoxInImage(group.box, *view, {});
    }
    groups.push_back(std::move(group));
  }
  return groups;
}

}  // namespace horopter
