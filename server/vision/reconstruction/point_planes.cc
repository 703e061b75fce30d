#include "server/vision/reconstruction/point_planes.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>

namespace horopter {
namespace {

constexpr int kRefits = 3;

std::vector<int> Near(std::span<const Eigen::Vector3d> points,
                      const std::vector<int>& among,
                      const PointPlane& plane,
                      double tolerance) {
  std::vector<int> near;
  for (const int j : among) {
    if (std::abs(plane.normal.dot(points[j]) - plane.offset) <= tolerance) near.push_back(j);
  }
  return near;
}

// Least squares; the points are more than three and not on a line.
void RefitPlane(std::span<const Eigen::Vector3d> points, PointPlane* plane) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int j : plane->points) mean += points[j];
  mean /= static_cast<double>(plane->points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int j : plane->points) scatter += (points[j] - mean) * (points[j] - mean).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  plane->normal = eigen.eigenvectors().col(0).normalized();
  plane->offset = plane->normal.dot(mean);
}

std::optional<PointPlane> LargestPlane(std::span<const Eigen::Vector3d> points,
                                       const std::vector<int>& among,
                                       double tolerance,
                                       const PointPlaneOptions& options,
                                       std::mt19937* rng) {
  PointPlane best;
  const auto n = static_cast<unsigned>(among.size());
  for (int k = 0; k < options.samples; ++k) {
    const Eigen::Vector3d& a = points[among[(*rng)() % n]];
    const Eigen::Vector3d& b = points[among[(*rng)() % n]];
    const Eigen::Vector3d& c = points[among[(*rng)() % n]];
    const Eigen::Vector3d normal = (b - a).cross(c - a);
    if (!(normal.norm() > tolerance * tolerance)) continue;
    PointPlane plane;
    plane.normal = normal.normalized();
    plane.offset = plane.normal.dot(a);
    plane.points = Near(points, among, plane, tolerance);
    if (plane.points.size() > best.points.size()) best = std::move(plane);
  }
  for (int round = 0; round < kRefits && std::ssize(best.points) >= options.min_points; ++round) {
    RefitPlane(points, &best);
    best.points = Near(points, among, best, tolerance);
  }
  if (std::ssize(best.points) < options.min_points) return std::nullopt;
  return best;
}

}  // namespace

std::vector<PointPlane> FindPointPlanes(std::span<const Eigen::Vector3d> points,
                                        double tolerance,
                                        const PointPlaneOptions& options) {
  std::vector<int> left;
  for (int j = 0; j < std::ssize(points); ++j) {
    if (points[j].allFinite()) left.push_back(j);
  }
  std::mt19937 rng(options.seed);
  std::vector<PointPlane> planes;
  while (std::ssize(planes) < options.max_planes && std::ssize(left) >= options.min_points) {
    std::optional<PointPlane> plane = LargestPlane(points, left, tolerance, options, &rng);
    if (!plane) break;
    std::vector<int> others;
    std::set_difference(left.begin(),
                        left.end(),
                        plane->points.begin(),
                        plane->points.end(),
                        std::back_inserter(others));
    left = std::move(others);
    planes.push_back(*std::move(plane));
  }
  return planes;
}

int SupportingPlaneOf(std::span<const Eigen::Vector3d> points,
                      std::span<const std::optional<CalibratedView>> views,
                      double tolerance,
                      const PointPlaneOptions& options,
                      std::vector<PointPlane>* planes) {
  for (size_t k = 0; k < planes->size(); ++k) {
    PointPlane& plane = (*planes)[k];
    int above = 0, below = 0;
    for (const auto& view : views) {
      if (!view) continue;
      const Eigen::Vector3d centre = view->camera_from_scene.Inverse().t;
      (plane.normal.dot(centre) > plane.offset ? above : below) += 1;
    }
    if ((above > 0) == (below > 0)) continue;
    if (below > 0) {
      plane.normal = -plane.normal;
      plane.offset = -plane.offset;
    }
    const auto under = std::count_if(points.begin(), points.end(), [&](const auto& x) {
      return plane.normal.dot(x) < plane.offset - tolerance;
    });
    if (static_cast<double>(under) <=
        options.max_share_under * static_cast<double>(points.size())) {
      return static_cast<int>(k);
    }
  }
  return -1;
}

}  // namespace horopter
