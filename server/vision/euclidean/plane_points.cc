#include "server/vision/euclidean/plane_points.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

namespace horopter {
namespace {

constexpr int kMatchesPerPair = 60;     // spread evenly; for time
constexpr double kAgreePx = 12.0;       // in the other image; cameras are rough
constexpr int kMinMatches = 12;         // of fewer there is no plane
constexpr int kTrials = 300;            // draws of three points
constexpr double kOnPlaneShare = 0.01;  // inlier distance, share of the distance from the anchor

struct Candidate {
  PlanePoints::Match match;
  Eigen::Vector3d point;  // scene, relative to the anchor
};

Eigen::Vector3d SceneRay(const CalibratedCamera& view, const Eigen::Vector2d& pixel) {
  return (view.camera_from_scene.R.transpose() * NormalizedPoint(view.camera, pixel).homogeneous())
      .normalized();
}

// Midpoint of the common perpendicular; empty for nearly parallel rays or points behind a camera.
std::optional<Eigen::Vector3d> Triangulate(const CalibratedCamera& a,
                                           const CalibratedCamera& b,
                                           const PlanePoints::Match& m) {
  const Eigen::Vector3d ca = a.camera_from_scene.Inverse().t, cb = b.camera_from_scene.Inverse().t;
  const Eigen::Vector3d u = SceneRay(a, m.pixel_a), v = SceneRay(b, m.pixel_b);
  const double uv = u.dot(v), d = 1.0 - uv * uv;
  if (d < 1e-4) return std::nullopt;
  const Eigen::Vector3d w = cb - ca;
  const double s = (w.dot(u) - uv * w.dot(v)) / d, t = (uv * w.dot(u) - w.dot(v)) / d;
  if (s <= 0 || t <= 0) return std::nullopt;
  return Eigen::Vector3d(0.5 * (ca + s * u + cb + t * v));
}

}  // namespace

std::optional<Eigen::Vector2d> PlaneTransferError(const CalibratedCamera& a,
                                                  const CalibratedCamera& b,
                                                  const PlanePoints& points,
                                                  const PlanePoints::Match& m) {
  const Eigen::Vector3d origin = a.camera_from_scene.Inverse().t, ray = SceneRay(a, m.pixel_a);
  const double denominator = points.plane.dot(ray);
  if (denominator == 0) return std::nullopt;
  const double s = (-1.0 - points.plane.dot(origin - points.anchor)) / denominator;
  const Eigen::Vector3d p = b.camera_from_scene * Eigen::Vector3d(origin + s * ray);
  if (!(s > 0 && p.z() > 0)) return std::nullopt;
  return Eigen::Vector2d(Project(b.camera, p) - m.pixel_b);
}

PlanePoints FindPlanePoints(const MatchingResult& matching,
                            const std::vector<std::optional<CalibratedCamera>>& views) {
  PlanePoints out;
  int known = 0;
  for (const auto& v : views) {
    if (!v) continue;
    out.anchor += v->camera_from_scene.Inverse().t;
    ++known;
  }
  if (known < 2) return out;
  out.anchor /= known;
  std::vector<Candidate> candidates;
  for (const PlaneHomography& pair : matching.planes) {
    if (!views[pair.view_a] || !views[pair.view_b]) continue;
    const std::size_t n = std::min(pair.inliers_a.size(), pair.inliers_b.size());
    const std::size_t kept = std::min<std::size_t>(n, kMatchesPerPair);
    for (std::size_t i = 0; i < kept; ++i) {
      const std::size_t k = i * n / kept;
      const PlanePoints::Match m{pair.view_a, pair.view_b, pair.inliers_a[k], pair.inliers_b[k]};
      const auto point = Triangulate(*views[m.view_a], *views[m.view_b], m);
      if (point) candidates.push_back({m, *point - out.anchor});
    }
  }
  if (static_cast<int>(candidates.size()) < kMinMatches) return out;

  std::mt19937 rng(11);
  std::uniform_int_distribution<std::size_t> pick(0, candidates.size() - 1);
  int most = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    Eigen::Matrix3d P;
    P << candidates[pick(rng)].point, candidates[pick(rng)].point, candidates[pick(rng)].point;
    const Eigen::FullPivLU<Eigen::Matrix3d> lu(P.transpose());
    if (!lu.isInvertible()) continue;
    const Eigen::Vector3d m = lu.solve(Eigen::Vector3d::Constant(-1.0));
    const int inliers = static_cast<int>(
        std::count_if(candidates.begin(), candidates.end(), [&](const Candidate& c) {
          return std::abs(m.dot(c.point) + 1.0) < kOnPlaneShare;
        }));
    if (inliers > most) {
      most = inliers;
      out.plane = m;
    }
  }
  for (const Candidate& c : candidates) {
    const auto e = PlaneTransferError(*views[c.match.view_a], *views[c.match.view_b], out, c.match);
    if (e && e->norm() < kAgreePx) out.matches.push_back(c.match);
  }
  if (static_cast<int>(out.matches.size()) < kMinMatches) out.matches.clear();
  return out;
}

}  // namespace horopter
