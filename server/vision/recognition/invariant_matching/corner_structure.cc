#include "server/vision/recognition/invariant_matching/corner_structure.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

constexpr int kMinEdgeViews = 2;  // in which the same segments end in both corners of an edge
// Of the way that edges of corners that point at each other reach
constexpr double kLeastEdgeReach = 0.6;
constexpr double kMostEdgeReach = 1.15;  // ... and at most
constexpr std::size_t kMinCorners = 5;   // one over the four corners of a key

Eigen::Vector2d Undistorted(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  return camera.focal_px * NormalizedPoint(camera, pixel) + Eigen::Vector2d(camera.cx, camera.cy);
}

// Centre to the origin, mean square coordinate one.
Eigen::Matrix4d CornerBalancing(std::span<const SpaceCorner> corners) {
  const auto n = static_cast<double>(corners.size());
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const SpaceCorner& c : corners) centre += c.point / n;
  double moment = 0.0;
  for (const SpaceCorner& c : corners) moment += (c.point - centre).squaredNorm() / (3.0 * n);
  const double scale = 1.0 / std::sqrt(std::max(moment, 1e-300));
  Eigen::Matrix4d out = Eigen::Matrix4d::Identity();
  out.topLeftCorner<3, 3>() *= scale;
  out.topRightCorner<3, 1>() = -scale * centre;
  return out;
}

// d pixel / d point, without distortion.
Eigen::Matrix<double, 2, 3> ProjectionJacobian(const CameraMatrix& P, const Eigen::Vector3d& X) {
  const Eigen::Vector3d y = P * X.homogeneous();
  Eigen::Matrix<double, 2, 3> J;
  for (int k = 0; k < 2; ++k) {
    J.row(k) = (P.row(k).head<3>() - y(k) / y.z() * P.row(2).head<3>()) / y.z();
  }
  return J;
}

bool SharesSegments(const SpaceCorner& a, const SpaceCorner& b, int min_views) {
  std::set<std::pair<int, int>> of_a;
  for (const SpaceCorner::Edge& e : a.edges) {
    for (const ShownFeature& s : e.segments) of_a.insert({s.view, s.feature});
  }
  std::set<int> views;
  for (const SpaceCorner::Edge& e : b.edges) {
    for (const ShownFeature& s : e.segments) {
      if (of_a.count({s.view, s.feature}) > 0) views.insert(s.view);
    }
  }
  return static_cast<int>(views.size()) >= min_views;
}

// Whether one of the corner's edges points at `target` and reaches about so far.
bool PointsAt(const SpaceCorner& corner,
              const Eigen::Vector3d& target,
              const CornerStructureOptions& options) {
  const Eigen::Vector3d off = target - corner.point;
  const double distance = off.norm();
  return std::any_of(corner.edges.begin(), corner.edges.end(), [&](const SpaceCorner::Edge& e) {
    return e.direction.dot(off) > std::cos(options.direction_rad) * distance &&
           e.length_m > kLeastEdgeReach * distance && e.length_m < kMostEdgeReach * distance;
  });
}

void AddPoint(std::span<const FeatureView> views,
              const SpaceCorner& corner,
              const Eigen::Matrix4d& structure_from_scene,
              double sigma_px,
              SceneStructure* out) {
  const int index = static_cast<int>(out->points.size());
  const Eigen::Vector3d X = (structure_from_scene * corner.point.homogeneous()).hnormalized();
  out->points.push_back(X);
  out->point_track.push_back(index);
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (const ShownFeature& s : corner.junctions) {
    const Junction& junction = views[s.view].features->junctions[s.feature];
    PointObservation o;
    o.view = s.view;
    o.point = index;
    o.pixel = Undistorted(views[s.view].camera, junction.point);
    o.sigma_px = std::max(sigma_px / views[s.view].working_from_image,
                          std::sqrt(0.5 * junction.covariance.trace()));
    const Eigen::Matrix<double, 2, 3> J = ProjectionJacobian(*out->cameras[s.view], X) / o.sigma_px;
    information += J.transpose() * J;
    out->point_observations.push_back(o);
  }
  out->covariance.block<3, 3>(3 * index, 3 * index) = information.inverse();
}

// The corners' edges as lines; what both ends of one see is one line.
void AddSegments(std::span<const FeatureView> views,
                 std::span<const SpaceCorner> corners,
                 const Eigen::Matrix4d& structure_from_scene,
                 const CornerStructureOptions& options,
                 SceneStructure* out) {
  std::set<std::pair<int, int>> used;
  for (const SpaceCorner& corner : corners) {
    for (const SpaceCorner::Edge& e : corner.edges) {
      int known = 0;
      for (const ShownFeature& s : e.segments) known += used.count({s.view, s.feature}) > 0;
      if (known >= kMinEdgeViews) continue;
      const int index = static_cast<int>(out->lines.size());
      const Eigen::Vector4d far = (corner.point + e.length_m * e.direction).homogeneous();
      out->lines.push_back(
          JoinPoints(Eigen::Vector4d(structure_from_scene * corner.point.homogeneous()),
                     Eigen::Vector4d(structure_from_scene * far))
              .normalized());
      out->line_track.push_back(index);
      for (const ShownFeature& s : e.segments) {
        const Segment& segment = views[s.view].features->segments[s.feature];
        LineObservation o;
        o.view = s.view;
        o.line = index;
        o.start = Undistorted(views[s.view].camera, segment.start);
        o.end = Undistorted(views[s.view].camera, segment.end);
        o.sigma_px = options.sigma_px / views[s.view].working_from_image;
        const Eigen::Vector3d seen = ProjectLine(*out->cameras[s.view], out->lines[index]);
        const double miss = std::max(std::abs(seen.dot(o.start.homogeneous())),
                                     std::abs(seen.dot(o.end.homogeneous())));
        if (!(miss * views[s.view].working_from_image < options.max_line_px)) continue;
        used.insert({s.view, s.feature});
        out->line_observations.push_back(o);
      }
    }
  }
}

}  // namespace

absl::StatusOr<CornerStructure> StructureOfCorners(std::span<const FeatureView> views,
                                                   std::span<const SpaceCorner> corners,
                                                   const CornerStructureOptions& options) {
  if (corners.size() < kMinCorners) {
    return absl::FailedPreconditionError(
        absl::StrCat(corners.size(), " corners in space, need ", kMinCorners));
  }
  if (corners.size() > kMaxStructurePoints) {
    return absl::InvalidArgumentError(
        absl::StrCat(corners.size(), " corners, at most ", kMaxStructurePoints));
  }
  CornerStructure result;
  result.structure_from_scene = CornerBalancing(corners);
  SceneStructure& out = result.structure;
  out.metric = true;
  const Eigen::Matrix4d scene_from_structure = result.structure_from_scene.inverse();
  for (const FeatureView& view : views) {
    CameraMatrix P;
    P << view.camera_from_scene.R, view.camera_from_scene.t;
    out.cameras.emplace_back(CameraMatrix(view.camera.K() * P * scene_from_structure));
  }
  const auto n = static_cast<Eigen::Index>(corners.size());
  out.covariance = Eigen::MatrixXd::Zero(3 * n, 3 * n);
  for (const SpaceCorner& corner : corners)
    AddPoint(views, corner, result.structure_from_scene, options.sigma_px, &out);
  if (!out.covariance.allFinite()) {
    return absl::FailedPreconditionError("a corner is seen along one ray only");
  }
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      if (SharesSegments(corners[a], corners[b], kMinEdgeViews) ||
          (PointsAt(corners[a], corners[b].point, options) &&
           PointsAt(corners[b], corners[a].point, options))) {
        out.edges.push_back({a, b});
      }
    }
  }
  AddSegments(views, corners, result.structure_from_scene, options, &out);
  return result;
}

}  // namespace horopter
