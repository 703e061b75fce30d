#include "server/vision/recognition/candidates/corner_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "server/vision/recognition/scoring/circle_sighting.h"

namespace horopter {
namespace {

// Columns: along u + v, along u - v, and across both; u, v unit and not parallel.
Eigen::Matrix3d BisectorFrame(const Eigen::Vector3d& u, const Eigen::Vector3d& v) {
  Eigen::Matrix3d frame;
  frame.col(0) = (u + v).normalized();
  frame.col(1) = (u - v).normalized();
  frame.col(2) = frame.col(0).cross(frame.col(1));
  return frame;
}

// Adds a pose that scores well enough. best: of those before.
void Offer(const PreparedObject& object,
           std::span<const KnownView> views,
           const Rigid3& pose,
           const CornerSearchOptions& options,
           double* best,
           PosePool* pool) {
  const double floor = std::max(pool->floor(), *best - options.near_best);
  const double quick = MeanQuick(object, views, 1.0, pose, options.quick_reach_px, floor);
  if (quick < floor) return;
  *best = std::max(*best, quick);
  pool->Add({pose, 1.0, quick, 1.0});
}

}  // namespace

Rigid3 PoseFromCorner(const Eigen::Vector3d& vertex,
                      const Eigen::Vector3d& u,
                      const Eigen::Vector3d& v,
                      const Eigen::Vector3d& point,
                      const Eigen::Vector3d& p,
                      const Eigen::Vector3d& q) {
  Rigid3 pose;
  pose.R = BisectorFrame(p, q) * BisectorFrame(u, v).transpose();
  pose.t = point - pose.R * vertex;
  return pose;
}

std::vector<PooledPose> PosesFromCorners(const PreparedObject& object,
                                         std::span<const KnownView> views,
                                         std::span<const SpaceCorner> corners,
                                         const CornerSearchOptions& options) {
  PosePool pool(options.min_quick);
  double best = 0.0;
  struct ModelCorner {
    Eigen::Vector3d vertex, u, v;
    double length_u, length_v, angle;
  };
  std::vector<ModelCorner> model;
  for (const int index : object.distinct_paths) {
    const VertexPath& path = object.paths[index];
    const Eigen::Vector3d& b = object.model.vertices[path.b];
    const Eigen::Vector3d u = (object.model.vertices[path.a] - b).normalized();
    const Eigen::Vector3d v = (object.model.vertices[path.c] - b).normalized();
    model.push_back(
        {b, u, v, path.length_ab, path.length_bc, std::acos(std::clamp(u.dot(v), -1.0, 1.0))});
  }
  const auto fits = [&](double seen, double length) {
    return seen <= (1.0 + options.length_share) * length + options.length_slack_m &&
           seen >= options.min_length_share * length;
  };
  const auto complete = [&](double seen, double length) {
    return seen >= (1.0 - options.length_share) * length - options.length_slack_m;
  };
  for (const SpaceCorner& corner : corners) {
    for (std::size_t i = 0; i < corner.edges.size(); ++i) {
      for (std::size_t j = i + 1; j < corner.edges.size(); ++j) {
        const SpaceCorner::Edge &p = corner.edges[i], &q = corner.edges[j];
        const double angle = std::acos(std::clamp(p.direction.dot(q.direction), -1.0, 1.0));
        for (const ModelCorner& m : model) {
          if (std::abs(m.angle - angle) > options.angle_rad) continue;
          for (const bool swapped : {false, true}) {
            const SpaceCorner::Edge &at_u = swapped ? q : p, &at_v = swapped ? p : q;
            if (!fits(at_u.length_m, m.length_u) || !fits(at_v.length_m, m.length_v)) continue;
            if (options.one_complete && !complete(at_u.length_m, m.length_u) &&
                !complete(at_v.length_m, m.length_v)) {
              continue;
            }
            const Rigid3 pose =
                PoseFromCorner(m.vertex, m.u, m.v, corner.point, at_u.direction, at_v.direction);
            Offer(object, views, pose, options, &best, &pool);
          }
        }
      }
    }
  }
  return std::move(pool).Sorted();
}

std::vector<PooledPose> PosesFromCircles(const PreparedObject& object,
                                         std::span<const KnownView> views,
                                         std::span<const SpaceCircle> circles,
                                         const CornerSearchOptions& options) {
  PosePool pool(options.min_quick);
  double best = 0.0;
  for (const ModelCircle& model : CirclesOf(object.model)) {
    for (const SpaceCircle& circle : circles) {
      if (std::abs(std::log(circle.radius_m / model.radius_m)) > options.radius_log) continue;
      for (const double sign : {1.0, -1.0}) {
        for (int turn = 0; turn < options.turns; ++turn) {
          const Rigid3 pose = PoseFromCircle(model,
                                             circle.center,
                                             sign * circle.normal,
                                             2.0 * std::numbers::pi * turn / options.turns);
          Offer(object, views, pose, options, &best, &pool);
        }
      }
    }
  }
  return std::move(pool).Sorted();
}

}  // namespace horopter
