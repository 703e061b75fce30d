#include "server/vision/reconstruction/multiview_tracks.h"

#include <Eigen/Dense>
#include <cmath>
#include <set>
#include <string>
#include <utility>

namespace horopter {
namespace {

absl::Status CheckObservation(const char* what,
                              size_t index,
                              int view,
                              int feature,
                              bool finite,
                              double sigma,
                              int views,
                              int features,
                              std::set<std::pair<int, int>>* seen) {
  const std::string name = std::string(what) + "[" + std::to_string(index) + "]";
  if (view < 0 || view >= views) return absl::InvalidArgumentError(name + ": no such view");
  if (feature < 0 || feature >= features) {
    return absl::InvalidArgumentError(name + ": no such feature");
  }
  if (!finite) return absl::InvalidArgumentError(name + ": not finite");
  if (!(sigma > 0.0) || !std::isfinite(sigma)) {
    return absl::InvalidArgumentError(name + ": sigma_px must be positive");
  }
  if (!seen->emplace(view, feature).second) {
    return absl::InvalidArgumentError(name + ": seen twice in one view");
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status Validate(const MultiviewTracks& tracks) {
  const int views = static_cast<int>(tracks.sizes.size());
  if (views > kMaxViews) {
    return absl::InvalidArgumentError("sizes: " + std::to_string(views) + " views, at most " +
                                      std::to_string(kMaxViews));
  }
  if (tracks.points < 0 || tracks.lines < 0 || tracks.points > kMaxFeatures ||
      tracks.lines > kMaxFeatures) {
    return absl::InvalidArgumentError("points, lines: need 0.." + std::to_string(kMaxFeatures));
  }
  for (const ImageSize& size : tracks.sizes) {
    if (size.width <= 0 || size.height <= 0) {
      return absl::InvalidArgumentError("sizes: empty image");
    }
  }
  std::set<std::pair<int, int>> seen;
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    if (absl::Status s = CheckObservation("point_observations",
                                          k,
                                          o.view,
                                          o.point,
                                          o.pixel.allFinite(),
                                          o.sigma_px,
                                          views,
                                          tracks.points,
                                          &seen);
        !s.ok()) {
      return s;
    }
  }
  seen.clear();
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    const LineObservation& o = tracks.line_observations[k];
    const bool finite = o.start.allFinite() && o.end.allFinite() && o.start != o.end;
    if (absl::Status s = CheckObservation(
            "line_observations", k, o.view, o.line, finite, o.sigma_px, views, tracks.lines, &seen);
        !s.ok()) {
      return s;
    }
  }
  return absl::OkStatus();
}

ProjectiveScene EmptyScene(const MultiviewTracks& tracks) {
  ProjectiveScene scene;
  scene.cameras.resize(tracks.sizes.size());
  scene.points.resize(tracks.points);
  scene.lines.resize(tracks.lines);
  scene.point_inlier.assign(tracks.point_observations.size(), true);
  scene.line_inlier.assign(tracks.line_observations.size(), true);
  return scene;
}

Eigen::Matrix3d NormalizedFromPixels(const ImageSize& size) {
  const double s = 2.8 / (size.width + size.height);
  Eigen::Matrix3d T;
  T << s, 0, -0.5 * s * (size.width - 1), 0, s, -0.5 * s * (size.height - 1), 0, 0, 1;
  return T;
}

MultiviewTracks NormalizeTracks(const MultiviewTracks& tracks) {
  MultiviewTracks out = tracks;
  std::vector<Eigen::Matrix3d> T;
  for (const ImageSize& size : tracks.sizes) T.push_back(NormalizedFromPixels(size));
  const auto map = [&](int view, const Eigen::Vector2d& x) {
    return Eigen::Vector2d(T[view](0, 0) * x + T[view].block<2, 1>(0, 2));
  };
  for (PointObservation& o : out.point_observations) {
    o.pixel = map(o.view, o.pixel);
    o.sigma_px *= T[o.view](0, 0);
  }
  for (LineObservation& o : out.line_observations) {
    o.start = map(o.view, o.start);
    o.end = map(o.view, o.end);
    o.sigma_px *= T[o.view](0, 0);
  }
  return out;
}

void CamerasToPixels(const std::vector<ImageSize>& sizes, ProjectiveScene* scene) {
  for (size_t v = 0; v < sizes.size(); ++v) {
    if (!scene->cameras[v]) continue;
    // T is upper triangular with a known inverse.
    const Eigen::Matrix3d T = NormalizedFromPixels(sizes[v]);
    const double s = T(0, 0);
    Eigen::Matrix3d inverse;
    inverse << 1 / s, 0, -T(0, 2) / s, 0, 1 / s, -T(1, 2) / s, 0, 0, 1;
    CameraMatrix P = inverse * *scene->cameras[v];
    scene->cameras[v] = P / P.norm();
  }
}

Eigen::Vector2d PointResidual(const CameraMatrix& P,
                              const Eigen::Vector4d& X,
                              const PointObservation& o) {
  return (ProjectPoint(P, X) - o.pixel) / o.sigma_px;
}

Eigen::Vector2d LineResidual(const CameraMatrix& P,
                             const PluckerLine& L,
                             const LineObservation& o) {
  const Eigen::Vector3d l = ProjectLine(P, L);
  return Eigen::Vector2d(l.dot(o.start.homogeneous()), l.dot(o.end.homogeneous())) / o.sigma_px;
}

ResidualSummary Summarize(const MultiviewTracks& tracks, const ProjectiveScene& scene) {
  ResidualSummary out;
  double sigma2 = 0.0, px2 = 0.0;
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    if (!scene.point_inlier[k] || !scene.cameras[o.view] || !scene.points[o.point]) continue;
    const double r = PointResidual(*scene.cameras[o.view], *scene.points[o.point], o).squaredNorm();
    sigma2 += r;
    px2 += r * o.sigma_px * o.sigma_px;
    ++out.point_observations;
  }
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    const LineObservation& o = tracks.line_observations[k];
    if (!scene.line_inlier[k] || !scene.cameras[o.view] || !scene.lines[o.line]) continue;
    const double r = LineResidual(*scene.cameras[o.view], *scene.lines[o.line], o).squaredNorm();
    sigma2 += r;
    px2 += r * o.sigma_px * o.sigma_px;
    ++out.line_observations;
  }
  const int n = 2 * (out.point_observations + out.line_observations);
  if (n > 0) {
    out.rms_sigma = std::sqrt(sigma2 / n);
    out.rms_px = std::sqrt(px2 / n);
  }
  return out;
}

}  // namespace horopter
