#include "server/vision/recognition/invariant_matching/scene_structure.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "server/base/union_find.h"
#include "server/vision/geometry/collineation.h"
#include "server/vision/reconstruction/bundle_manifolds.h"
#include "server/vision/reconstruction/chirality.h"
#include "server/vision/reconstruction/projective_bundle.h"

namespace horopter {
namespace {

constexpr int kMinPoints = 5;               // of fewer there are no keys to compare
constexpr double kCovarianceFloor = 1e-16;  // squared units of the scene; keeps it invertible

// Tracks with enough inlier observations in known cameras, among those marked usable.
std::vector<int> WellSeen(const MultiviewTracks& tracks,
                          const ProjectiveScene& inliers,
                          const std::vector<bool>& usable_point,
                          const std::vector<bool>& usable_view,
                          int min_views) {
  std::vector<int> seen(tracks.points, 0), out;
  for (std::size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    seen[o.point] += inliers.point_inlier[k] && usable_view[o.view];
  }
  for (int j = 0; j < tracks.points; ++j) {
    if (usable_point[j] && seen[j] >= min_views) out.push_back(j);
  }
  return out;
}

absl::Status CheckCount(std::size_t points) {
  if (points < kMinPoints) {
    return absl::FailedPreconditionError(
        absl::StrCat(points, " points seen in enough views, need ", kMinPoints));
  }
  if (points > kMaxStructurePoints) {
    return absl::InvalidArgumentError(
        absl::StrCat(points, " points, at most ", kMaxStructurePoints));
  }
  return absl::OkStatus();
}

// Affine map that centres the points and makes their second moment the identity (similarity: its
// trace 3).
Eigen::Matrix4d Balancing(const std::vector<Eigen::Vector3d>& points, bool similarity) {
  const double n = static_cast<double>(points.size());
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const auto& x : points) centre += x / n;
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  for (const auto& x : points) moment += (x - centre) * (x - centre).transpose() / n;
  Eigen::Matrix3d A;
  if (similarity) {
    A = Eigen::Matrix3d::Identity() / std::sqrt(std::max(moment.trace() / 3.0, 1e-300));
  } else {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moment);
    const Eigen::Vector3d values = eigen.eigenvalues().cwiseMax(1e-9 * eigen.eigenvalues()(2));
    A = eigen.eigenvectors() * values.cwiseSqrt().cwiseInverse().asDiagonal() *
        eigen.eigenvectors().transpose();
  }
  Eigen::Matrix4d out = Eigen::Matrix4d::Identity();
  out.topLeftCorner<3, 3>() = A;
  out.topRightCorner<3, 1>() = -A * centre;
  return out;
}

// The scene's lines, mapped by H, and where they were seen.
void AddLines(const MultiviewTracks& tracks,
              const ProjectiveScene& scene,
              const Eigen::Matrix4d& H,
              SceneStructure* out) {
  std::vector<int> line_index(tracks.lines, -1);
  for (int j = 0; j < tracks.lines; ++j) {
    if (!scene.lines[j]) continue;
    const PluckerLine line = MapLine(H, *scene.lines[j]).normalized();
    if (!line.allFinite()) continue;
    line_index[j] = static_cast<int>(out->lines.size());
    out->lines.push_back(line);
    out->line_track.push_back(j);
  }
  for (std::size_t k = 0; k < tracks.line_observations.size(); ++k) {
    LineObservation o = tracks.line_observations[k];
    if (!scene.line_inlier[k] || !scene.cameras[o.view] || line_index[o.line] < 0) continue;
    o.line = line_index[o.line];
    out->line_observations.push_back(o);
  }
}

// What both kinds of scenes share: homogeneous points (unit norm), cameras, lines, all in the frame
// of `scene`, mapped by H.
absl::StatusOr<SceneStructure> Assemble(const MultiviewTracks& tracks,
                                        const ProjectiveScene& scene,
                                        const BundleCovariance& covariance,
                                        const std::vector<int>& chosen,
                                        const Eigen::Matrix4d& frame_from_scene,
                                        std::span<const std::array<int, 2>> edges,
                                        bool metric) {
  std::vector<Eigen::Vector3d> raw;
  for (const int j : chosen) raw.push_back((frame_from_scene * *scene.points[j]).hnormalized());
  const Eigen::Matrix4d H = Balancing(raw, metric) * frame_from_scene;
  SceneStructure out;
  out.metric = metric;
  out.sigma_factor = std::sqrt(std::max(1.0, covariance.variance_factor));
  out.point_track = chosen;
  const auto n = static_cast<Eigen::Index>(chosen.size());
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(3 * n, 3 * n);
  std::vector<int> index(tracks.points, -1);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector4d X = scene.points[chosen[i]]->normalized(), y = H * X;
    out.points.emplace_back(y.hnormalized());
    Eigen::Matrix<double, 3, 4> to_finite;
    to_finite << Eigen::Matrix3d::Identity() / y.w(), -y.head<3>() / (y.w() * y.w());
    J.block<3, 3>(3 * i, 3 * i) = to_finite * H * SphereTangent<4>(X);
    index[chosen[i]] = static_cast<int>(i);
  }
  out.covariance =
      out.sigma_factor * out.sigma_factor * J * covariance.Features(chosen) * J.transpose();
  out.covariance.diagonal().array() += kCovarianceFloor;
  if (!out.covariance.allFinite()) return absl::FailedPreconditionError("covariance is not finite");
  for (const auto& edge : edges) {
    if (edge[0] < 0 || edge[1] < 0 || edge[0] >= tracks.points || edge[1] >= tracks.points) {
      return absl::InvalidArgumentError("edges: name points that are no tracks");
    }
    if (index[edge[0]] < 0 || index[edge[1]] < 0 || edge[0] == edge[1]) continue;
    out.edges.push_back({index[edge[0]], index[edge[1]]});
  }
  const Eigen::Matrix4d inverse = H.inverse();
  for (const auto& P : scene.cameras) {
    out.cameras.emplace_back();
    if (P) out.cameras.back() = CameraMatrix(*P * inverse);
  }
  for (std::size_t k = 0; k < tracks.point_observations.size(); ++k) {
    PointObservation o = tracks.point_observations[k];
    if (!scene.point_inlier[k] || !scene.cameras[o.view] || index[o.point] < 0) continue;
    o.point = index[o.point];
    out.point_observations.push_back(o);
  }
  AddLines(tracks, scene, H, &out);
  return out;
}

bool SizesAgree(const MultiviewTracks& tracks, const ProjectiveScene& scene) {
  return scene.cameras.size() == tracks.sizes.size() &&
         scene.points.size() == static_cast<std::size_t>(tracks.points) &&
         scene.lines.size() == static_cast<std::size_t>(tracks.lines) &&
         scene.point_inlier.size() == tracks.point_observations.size() &&
         scene.line_inlier.size() == tracks.line_observations.size();
}

// Median distance of the points from their middle.
double Extent(const SceneStructure& structure, const std::vector<int>& points) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const int i : points) centre += structure.points[i] / static_cast<double>(points.size());
  std::vector<double> distances;
  for (const int i : points) distances.push_back((structure.points[i] - centre).norm());
  std::nth_element(distances.begin(), distances.begin() + distances.size() / 2, distances.end());
  return distances[distances.size() / 2];
}

// Between the nearest points of two sets.
double Distance(const SceneStructure& structure,
                const std::vector<int>& a,
                const std::vector<int>& b) {
  double nearest = INFINITY;
  for (const int i : a) {
    for (const int k : b) {
      nearest = std::min(nearest, (structure.points[i] - structure.points[k]).norm());
    }
  }
  return nearest;
}

// ComponentOptions::unions of the components, nearest first; `grown` are the components with what
// was gathered to them.
std::vector<std::vector<int>> NearestUnions(const SceneStructure& structure,
                                            std::span<const std::vector<int>> components,
                                            std::span<const std::vector<int>> grown,
                                            const ComponentOptions& options) {
  struct Gap {
    double distance;
    std::vector<int> points;
  };
  std::vector<Gap> gaps;
  for (std::size_t a = 0; options.unions > 0 && a < components.size(); ++a) {
    for (std::size_t b = 0; b < a; ++b) {
      const double gap = Distance(structure, components[a], components[b]);
      const double extent =
          std::max(Extent(structure, components[a]), Extent(structure, components[b]));
      if (!(gap < options.reach * extent)) continue;
      std::vector<int> both = grown[a];
      both.insert(both.end(), grown[b].begin(), grown[b].end());
      gaps.push_back({gap / extent, std::move(both)});
    }
  }
  std::stable_sort(
      gaps.begin(), gaps.end(), [](const Gap& a, const Gap& b) { return a.distance < b.distance; });
  if (static_cast<int>(gaps.size()) > options.unions) gaps.resize(options.unions);
  std::vector<std::vector<int>> out;
  for (Gap& gap : gaps) out.push_back(std::move(gap.points));
  return out;
}

}  // namespace

Eigen::MatrixXd SceneStructure::CovarianceOf(std::span<const int> of_points) const {
  const auto n = static_cast<Eigen::Index>(of_points.size());
  Eigen::MatrixXd out(3 * n, 3 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index k = 0; k < n; ++k) {
      out.block<3, 3>(3 * i, 3 * k) = covariance.block<3, 3>(3 * of_points[i], 3 * of_points[k]);
    }
  }
  return out;
}

absl::StatusOr<SceneStructure> ProjectiveStructure(const MultiviewTracks& tracks,
                                                   const ProjectiveScene& scene,
                                                   std::span<const std::array<int, 2>> edges,
                                                   int min_views) {
  if (!SizesAgree(tracks, scene)) return absl::InvalidArgumentError("scene: not of these tracks");
  const auto quasi_affine = FindQuasiAffineFrame(tracks, scene);
  if (!quasi_affine) {
    return absl::FailedPreconditionError("no plane at infinity leaves the scene on one side");
  }
  std::vector<bool> views;
  for (std::size_t v = 0; v < scene.cameras.size(); ++v) {
    views.push_back(scene.cameras[v] && quasi_affine->camera_consistent[v]);
  }
  const std::vector<int> chosen =
      WellSeen(tracks, scene, quasi_affine->point_consistent, views, min_views);
  if (absl::Status status = CheckCount(chosen.size()); !status.ok()) return status;
  ProjectiveScene normalized = scene;
  for (std::size_t v = 0; v < scene.cameras.size(); ++v) {
    if (!scene.cameras[v]) continue;
    const CameraMatrix P = NormalizedFromPixels(tracks.sizes[v]) * *scene.cameras[v];
    normalized.cameras[v] = CameraMatrix(P / P.norm());
  }
  const auto covariance = ProjectiveCovariance(NormalizeTracks(tracks), normalized);
  if (!covariance) return absl::FailedPreconditionError("the structure has no covariance");
  ProjectiveScene kept = scene;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) kept.cameras[v].reset();
  }
  return Assemble(tracks, kept, *covariance, chosen, quasi_affine->H, edges, false);
}

absl::StatusOr<SceneStructure> MetricStructure(const MultiviewTracks& tracks,
                                               const ProjectiveScene& inliers,
                                               const CalibratedScene& scene,
                                               const BundleCovariance& covariance,
                                               std::span<const std::array<int, 2>> edges,
                                               int min_views) {
  ProjectiveScene linear = inliers;
  MultiviewTracks undistorted = tracks;
  if (!SizesAgree(tracks, inliers) || scene.points.size() != linear.points.size() ||
      scene.views.size() != linear.cameras.size() || scene.lines.size() != linear.lines.size()) {
    return absl::InvalidArgumentError("scene: not of these tracks");
  }
  std::vector<bool> views(scene.views.size(), false), points(scene.points.size(), false);
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    linear.cameras[v].reset();
    if (!scene.views[v]) continue;
    CameraMatrix P;
    P << scene.views[v]->camera_from_scene.R, scene.views[v]->camera_from_scene.t;
    linear.cameras[v] = CameraMatrix(scene.views[v]->camera.K() * P);
    views[v] = true;
  }
  for (std::size_t j = 0; j < scene.points.size(); ++j) {
    linear.points[j].reset();
    if (!scene.points[j] || covariance.feature_size[j] != 3) continue;
    linear.points[j] = Eigen::Vector4d(scene.points[j]->homogeneous().normalized());
    points[j] = true;
  }
  for (std::size_t j = 0; j < scene.lines.size(); ++j) linear.lines[j] = scene.lines[j];
  const auto undistort = [&](int view, Eigen::Vector2d* pixel) {
    if (!scene.views[view] || scene.views[view]->camera.k1 == 0.0) return;
    const PinholeCamera& camera = scene.views[view]->camera;
    *pixel =
        camera.focal_px * NormalizedPoint(camera, *pixel) + Eigen::Vector2d(camera.cx, camera.cy);
  };
  for (PointObservation& o : undistorted.point_observations) undistort(o.view, &o.pixel);
  for (LineObservation& o : undistorted.line_observations) {
    undistort(o.view, &o.start);
    undistort(o.view, &o.end);
  }
  const std::vector<int> chosen = WellSeen(tracks, inliers, points, views, min_views);
  if (absl::Status status = CheckCount(chosen.size()); !status.ok()) return status;
  return Assemble(
      undistorted, linear, covariance, chosen, Eigen::Matrix4d::Identity(), edges, true);
}

std::vector<std::vector<int>> StructureComponents(const SceneStructure& structure,
                                                  const ComponentOptions& options) {
  const int n = static_cast<int>(structure.points.size());
  UnionFind sets(n);
  for (const auto& [a, b] : structure.edges) sets.Join(a, b);
  std::vector<std::vector<int>> linked(n);
  for (int i = 0; i < n; ++i) linked[sets.Find(i)].push_back(i);
  std::erase_if(linked, [](const auto& c) { return c.empty(); });
  std::stable_sort(linked.begin(), linked.end(), [](const auto& a, const auto& b) {
    return a.size() > b.size();
  });
  const auto small = std::find_if(linked.begin(), linked.end(), [&](const auto& c) {
    return static_cast<int>(c.size()) < options.min_points;
  });
  std::vector<std::vector<int>> out(linked.begin(), small);
  std::vector<int> left_over;
  for (auto fragment = small; fragment != linked.end(); ++fragment) {
    bool taken = false;
    for (auto large = linked.begin(); large != small; ++large) {
      if (!(Distance(structure, *large, *fragment) < options.reach * Extent(structure, *large)))
        continue;
      std::vector<int>& grown = out[static_cast<std::size_t>(large - linked.begin())];
      grown.insert(grown.end(), fragment->begin(), fragment->end());
      taken = true;
    }
    if (!taken) left_over.insert(left_over.end(), fragment->begin(), fragment->end());
  }
  // What nothing links to anything is one component more, so that no point is lost.
  if (static_cast<int>(left_over.size()) >= options.min_points) out.push_back(left_over);
  const std::span<const std::vector<int>> larger(linked.begin(), small);
  for (std::vector<int>& both : NearestUnions(structure, larger, out, options))
    out.push_back(std::move(both));
  for (std::vector<int>& component : out) {
    std::sort(component.begin(), component.end());
    component.erase(std::unique(component.begin(), component.end()), component.end());
  }
  return out;
}

}  // namespace horopter
