#include "server/vision/reconstruction/view_registration.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "server/vision/geometry/projection.h"
#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/camera_resection.h"
#include "server/vision/reconstruction/matched_tracks.h"

namespace horopter {
namespace {

constexpr double kGatePx = 3.0;           // of an observation in the views that give a feature
constexpr double kMinRayAngle = 0.0175;   // 1 degree: below it depth is noise
constexpr double kMinPlaneAngle = 0.035;  // of two back-projected planes that give a line
// As of the plane route: the posterior deviation knows nothing of wrong matches that survive.
constexpr double kFocalInflation = 3.0;

// Points and lines of the registered views, from observations in normalised coordinates.
struct Structure {
  std::vector<std::optional<Eigen::Vector3d>> points;
  std::vector<std::optional<PluckerLine>> lines;
};

// Observations of registered views, lens distortion undone, focal length 1; and their cameras.
struct NormalizedViews {
  MultiviewTracks tracks;
  ProjectiveScene scene;
};

NormalizedViews Normalize(const MultiviewTracks& tracks, const Reconstruction& r) {
  NormalizedViews out{tracks, EmptyScene(tracks)};
  for (size_t v = 0; v < r.views.size(); ++v) {
    if (!r.views[v]) continue;
    CameraMatrix P;
    P << r.views[v]->camera_from_scene.R, r.views[v]->camera_from_scene.t;
    out.scene.cameras[v] = P;
  }
  for (PointObservation& o : out.tracks.point_observations) {
    if (!r.views[o.view]) continue;
    o.pixel = NormalizedPoint(r.views[o.view]->camera, o.pixel);
    o.sigma_px = kGatePx / r.views[o.view]->camera.focal_px;
  }
  for (LineObservation& o : out.tracks.line_observations) {
    if (!r.views[o.view]) continue;
    o.start = NormalizedPoint(r.views[o.view]->camera, o.start);
    o.end = NormalizedPoint(r.views[o.view]->camera, o.end);
    o.sigma_px = kGatePx / r.views[o.view]->camera.focal_px;
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
                              const Reconstruction& r) {
  std::vector<int> out;
  for (const int k : observations) {
    if (r.views[list[k].view]) out.push_back(k);
  }
  return out;
}

Structure TriangulateAll(const MultiviewTracks& tracks,
                         const TrackIndex& index,
                         const Reconstruction& r) {
  const NormalizedViews n = Normalize(tracks, r);
  Structure out;
  out.points.resize(tracks.points);
  out.lines.resize(tracks.lines);
  for (int j = 0; j < tracks.points; ++j) {
    std::vector<int> seen = InRegistered(index.of_point[j], n.tracks.point_observations, r);
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
      rays.push_back(x -
                     r.views[n.tracks.point_observations[k].view]->camera_from_scene.Inverse().t);
    }
    if (x.allFinite() && WidestAngle(rays) > kMinRayAngle) out.points[j] = x;
  }
  for (int j = 0; j < tracks.lines; ++j) {
    std::vector<int> seen = InRegistered(index.of_line[j], n.tracks.line_observations, r);
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
      normals.push_back(r.views[o.view]->camera_from_scene.R.transpose() *
                        o.start.homogeneous().cross(o.end.homogeneous()));
    }
    if (WidestAngle(normals) > kMinPlaneAngle) out.lines[j] = L;
  }
  return out;
}

struct Sights {
  std::vector<PointSight> points;
  std::vector<LineSight> lines;
};

Sights SightsOf(const MultiviewTracks& tracks,
                const TrackIndex& index,
                const Structure& structure,
                int view) {
  Sights out;
  for (const int k : index.points_in_view[view]) {
    const PointObservation& o = tracks.point_observations[k];
    if (structure.points[o.point]) out.points.push_back({*structure.points[o.point], o.pixel});
  }
  for (const int k : index.lines_in_view[view]) {
    const LineObservation& o = tracks.line_observations[k];
    if (structure.lines[o.line]) out.lines.push_back({*structure.lines[o.line], o.start, o.end});
  }
  return out;
}

double WorstFocalSigma(const Reconstruction& r) {
  double worst = 0.0;
  for (const auto& view : r.views) {
    if (view) worst = std::max(worst, view->focal_log_sigma);
  }
  return worst;
}

}  // namespace

int RegisterRemainingViews(const MatchingResult& matching,
                           std::span<const ImageFeatures> features,
                           std::span<const ImageSize> sizes,
                           std::span<const ViewPrior> priors,
                           const ReconstructionOptions& options,
                           const StopRequested& stop,
                           Reconstruction* reconstruction) {
  Reconstruction& r = *reconstruction;
  const int views = static_cast<int>(r.views.size());
  r.view_refusals.assign(views, "");
  const auto known = std::count_if(
      r.views.begin(), r.views.end(), [](const auto& view) { return view.has_value(); });
  if (known < 2) r.view_refusals.assign(views, r.refusal);
  if (known < 2 || known == views) return 0;
  const MultiviewTracks tracks =
      TracksOfMatches(matching, MatchedPairs::kAll, features, sizes).tracks;
  const TrackIndex index = IndexTracks(tracks);
  ResectionOptions resection = options.registration;
  resection.seed = options.seed;
  resection.focal_prior_widths = options.focal_prior_widths;
  resection.focal_prior_log_sigma = options.focal_prior_log_sigma;
  const double others = WorstFocalSigma(r);
  int added = 0;
  std::vector<bool> failed(views, false);
  while (!IsStopRequested(stop)) {
    const Structure structure = TriangulateAll(tracks, index, r);
    int next = -1;
    Sights most;
    for (int v = 0; v < views; ++v) {
      if (r.views[v] || failed[v]) continue;
      Sights sights = SightsOf(tracks, index, structure, v);
      if (next >= 0 && sights.points.size() <= most.points.size()) continue;
      next = v;
      most = std::move(sights);
    }
    if (next < 0) break;
    const ViewPrior prior = priors.empty() ? ViewPrior() : priors[next];
    const auto found = ResectPinhole(most.points, most.lines, sizes[next], prior, resection, stop);
    failed[next] = true;
    if (!found.ok()) {
      r.view_refusals[next] = std::string(found.status().message());
      continue;
    }
    const double sigma = std::hypot(kFocalInflation * found->focal_log_sigma, others);
    if (r.trusted && sigma > std::max(kMaxTrustedFocalSigma, others)) {
      r.view_refusals[next] = "focal length known to " +
                              std::to_string(std::lround(100.0 * sigma)) + " %, need " +
                              std::to_string(std::lround(100.0 * kMaxTrustedFocalSigma)) + " %";
      continue;
    }
    r.view_refusals[next].clear();
    r.views[next] = CalibratedView{*found, sigma};
    ++added;
    for (int v = 0; v < views; ++v) failed[v] = failed[v] && r.views[v].has_value();
  }
  r.counts["views_resected"] = added;
  r.counts["views"] = static_cast<double>(known + added);
  return added;
}

}  // namespace horopter
