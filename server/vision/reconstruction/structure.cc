#include "server/vision/reconstruction/structure.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/projection.h"
#include "server/vision/reconstruction/trust.h"

namespace horopter {
namespace {

constexpr double kMinPlaneAngle = 0.035;  // of two back-projected planes that give a line

// Observations of registered views, lens distortion undone, focal length 1; and their cameras.
struct NormalizedViews {
  MultiviewTracks tracks;
  ProjectiveScene scene;
};

NormalizedViews Normalize(const MultiviewTracks& tracks,
                          std::span<const std::optional<CalibratedView>> views,
                          double gate_px) {
  NormalizedViews out{tracks, EmptyScene(tracks)};
  for (size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    CameraMatrix P;
    P << views[v]->camera_from_scene.R, views[v]->camera_from_scene.t;
    out.scene.cameras[v] = P;
  }
  for (PointObservation& o : out.tracks.point_observations) {
    if (!views[o.view]) continue;
    o.pixel = NormalizedPoint(views[o.view]->camera, o.pixel);
    o.sigma_px = gate_px / views[o.view]->camera.focal_px;
  }
  for (LineObservation& o : out.tracks.line_observations) {
    if (!views[o.view]) continue;
    o.start = NormalizedPoint(views[o.view]->camera, o.start);
    o.end = NormalizedPoint(views[o.view]->camera, o.end);
    o.sigma_px = gate_px / views[o.view]->camera.focal_px;
  }
  return out;
}

// From the observations that agree: the worst of three and more is dropped while they do not. The
// residual is in gates.
template <typename Feature, typename Triangulate, typename Residual>
std::optional<Feature> Agreeing(std::vector<int>* seen,
                                const Triangulate& triangulate,
                                const Residual& residual) {
  while (seen->size() >= 2) {
    const std::optional<Feature> x = triangulate(*seen);
    if (!x) return std::nullopt;
    const auto worst = std::max_element(seen->begin(), seen->end(), [&](int a, int b) {
      return residual(*x, a) < residual(*x, b);
    });
    if (residual(*x, *worst) < 1.0) return x;
    seen->erase(worst);
  }
  return std::nullopt;
}

// Largest angle between directions, radians.
double WidestAngle(const std::vector<Eigen::Vector3d>& directions) {
  double widest = 0.0;
  for (size_t i = 0; i < directions.size(); ++i) {
    for (size_t j = i + 1; j < directions.size(); ++j) {
      const double c = std::abs(directions[i].normalized().dot(directions[j].normalized()));
      widest = std::max(widest, std::acos(std::min(1.0, c)));
    }
  }
  return widest;
}

std::vector<int> InRegistered(const std::vector<int>& observations,
                              const auto& list,
                              std::span<const std::optional<CalibratedView>> views) {
  std::vector<int> out;
  for (const int k : observations) {
    if (views[list[k].view]) out.push_back(k);
  }
  return out;
}

}  // namespace

Structure TriangulateAll(const MultiviewTracks& tracks,
                         const TrackIndex& index,
                         std::span<const std::optional<CalibratedView>> views,
                         double gate_px) {
  const NormalizedViews n = Normalize(tracks, views, gate_px);
  Structure out;
  out.point_agrees.assign(tracks.point_observations.size(), false);
  out.points.resize(tracks.points);
  out.lines.resize(tracks.lines);
  for (int j = 0; j < tracks.points; ++j) {
    std::vector<int> seen = InRegistered(index.of_point[j], n.tracks.point_observations, views);
    const auto X = Agreeing<Eigen::Vector4d>(
        &seen,
        [&](const std::vector<int>& s) { return TriangulatePoint(n.tracks, s, n.scene, 2); },
        [&](const Eigen::Vector4d& x, int k) {
          const PointObservation& o = n.tracks.point_observations[k];
          const CameraMatrix& P = *n.scene.cameras[o.view];
          const double depth = P.row(2).dot(x) / x.w();
          return depth > 0.0 ? PointResidual(P, x, o).norm() : 1e6;
        });
    if (!X) continue;
    const Eigen::Vector3d x = X->hnormalized();
    std::vector<Eigen::Vector3d> rays;
    for (const int k : seen) {
      rays.push_back(x - views[n.tracks.point_observations[k].view]->camera_from_scene.Inverse().t);
    }
    if (!x.allFinite() || !(WidestAngle(rays) > kMinRayAngle)) continue;
    out.points[j] = x;
    for (const int k : seen) out.point_agrees[k] = true;
  }
  for (int j = 0; j < tracks.lines; ++j) {
    std::vector<int> seen = InRegistered(index.of_line[j], n.tracks.line_observations, views);
    const auto L = Agreeing<PluckerLine>(
        &seen,
        [&](const std::vector<int>& s) { return TriangulateLine(n.tracks, s, n.scene, 2); },
        [&](const PluckerLine& line, int k) {
          const LineObservation& o = n.tracks.line_observations[k];
          return LineResidual(*n.scene.cameras[o.view], line, o).cwiseAbs().maxCoeff();
        });
    if (!L || !(L->head<3>().norm() > 1e-9)) continue;
    std::vector<Eigen::Vector3d> normals;
    for (const int k : seen) {
      const LineObservation& o = n.tracks.line_observations[k];
      normals.push_back(views[o.view]->camera_from_scene.R.transpose() *
                        o.start.homogeneous().cross(o.end.homogeneous()));
    }
    if (WidestAngle(normals) > kMinPlaneAngle) out.lines[j] = L;
  }
  return out;
}

}  // namespace horopter
