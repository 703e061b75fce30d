// Resting poses from the convex hull of the mesh.
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <set>
#include <utility>

#include "server/base/stop_scope.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// Hull facets whose normals differ by less belong to one support plane.
constexpr double kMergeCos = 0.9998;  // about 1.1 degrees
// Points this close to a plane (share of the extent) touch it.
constexpr double kTouch = 4e-3;
// Jitter that brings the points into general position (share of the extent), well below kTouch.
constexpr double kJitter = 1e-6;

// Hulls of larger meshes are those of the vertices that are outermost in so many directions.
constexpr int kHullDirections = 1500;
// Poses of a round side: little margin, and another one so near.
constexpr double kRollCos = 0.966;    // 15 degrees
constexpr double kRollMargin = 0.08;  // share of the extent
constexpr double kRollStep = 0.0524;  // 3 degrees: by which poses of a round side are thinned out

struct Facet {
  std::array<int, 3> v;
  Eigen::Vector3d normal;
  double offset;  // normal . x = offset
};

Facet MakeFacet(const std::vector<Eigen::Vector3d>& p, int a, int b, int c) {
  Eigen::Vector3d n = (p[b] - p[a]).cross(p[c] - p[a]);
  const double length = n.norm();
  if (length > 0) n /= length;
  return {{a, b, c}, n, n.dot(p[a])};
}

// Four points that span a volume, or fewer when the set is flat.
std::vector<int> StartSimplex(const std::vector<Eigen::Vector3d>& p) {
  std::vector<int> s{0};
  auto farthest = [&](auto distance) {
    int best = 0;
    double best_d = -1;
    for (int i = 0; i < static_cast<int>(p.size()); ++i) {
      const double d = distance(p[i]);
      if (d > best_d) best_d = d, best = i;
    }
    return std::pair{best, best_d};
  };
  const auto [i1, d1] = farthest([&](const auto& x) { return (x - p[s[0]]).norm(); });
  if (d1 <= 0) return s;
  s.push_back(i1);
  const Eigen::Vector3d u = (p[i1] - p[s[0]]).normalized();
  const auto [i2, d2] = farthest([&](const auto& x) { return (x - p[s[0]]).cross(u).norm(); });
  if (d2 <= 1e-9 * d1) return s;
  s.push_back(i2);
  const Eigen::Vector3d n = (p[i1] - p[s[0]]).cross(p[i2] - p[s[0]]).normalized();
  const auto [i3, d3] = farthest([&](const auto& x) { return std::abs(n.dot(x - p[s[0]])); });
  if (d3 <= 1e-5 * d1) return s;
  s.push_back(i3);
  return s;
}

// Incremental convex hull, O(n * facets); parts have a few hundred distinct points.
std::vector<Facet> ConvexHull(const std::vector<Eigen::Vector3d>& p) {
  const std::vector<int> s = StartSimplex(p);
  if (s.size() < 4) return {};
  const Eigen::Vector3d inside = (p[s[0]] + p[s[1]] + p[s[2]] + p[s[3]]) / 4;
  std::vector<Facet> facets;
  auto add = [&](int a, int b, int c) {
    Facet f = MakeFacet(p, a, b, c);
    if (f.normal.dot(inside) > f.offset) f = MakeFacet(p, a, c, b);
    facets.push_back(f);
  };
  add(s[0], s[1], s[2]);
  add(s[0], s[1], s[3]);
  add(s[0], s[2], s[3]);
  add(s[1], s[2], s[3]);
  for (int i = 0; i < static_cast<int>(p.size()); ++i) {
    LeaveIfStopped();
    std::set<std::pair<int, int>> open_edges;
    std::vector<Facet> kept;
    for (const Facet& f : facets) {
      if (f.normal.dot(p[i]) <= f.offset) {
        kept.push_back(f);
        continue;
      }
      for (int k = 0; k < 3; ++k) {
        const std::pair<int, int> e{f.v[k], f.v[(k + 1) % 3]};
        if (open_edges.erase({e.second, e.first}) == 0) open_edges.insert(e);
      }
    }
    if (kept.size() == facets.size()) continue;
    // Slivers between points close together may see a point wrongly. What it sees must be bounded
    // by one loop, or the hull would fall apart: such a point is left out.
    std::set<int> starts;
    for (const auto& edge : open_edges) starts.insert(edge.first);
    if (starts.size() != open_edges.size()) continue;
    facets = std::move(kept);
    for (const auto& [a, b] : open_edges) facets.push_back(MakeFacet(p, a, b, i));
  }
  return facets;
}

Eigen::Vector3d CenterOfMass(const TriangleMesh& mesh) {
  Eigen::Vector3d weighted = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  double volume = 0;
  for (const auto& v : mesh.vertices) mean += v / static_cast<double>(mesh.vertices.size());
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]] - mean;
    const Eigen::Vector3d b = mesh.vertices[t[1]] - mean;
    const Eigen::Vector3d c = mesh.vertices[t[2]] - mean;
    const double v = a.dot(b.cross(c)) / 6;
    volume += v;
    weighted += v * (a + b + c) / 4;
  }
  if (std::abs(volume) < 1e-15) return mean;
  return mean + weighted / volume;
}

// Signed distance of the origin to the border of the convex hull of 2-D points; negative outside.
double InsideMargin(std::vector<Eigen::Vector2d> q) {
  std::sort(q.begin(), q.end(), [](const auto& a, const auto& b) {
    return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
  });
  auto cross = [](const Eigen::Vector2d& o, const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return (a.x() - o.x()) * (b.y() - o.y()) - (a.y() - o.y()) * (b.x() - o.x());
  };
  std::vector<Eigen::Vector2d> hull;
  for (int pass = 0; pass < 2; ++pass) {
    const std::size_t start = hull.size();
    for (const auto& x : q) {
      while (hull.size() >= start + 2 && cross(hull[hull.size() - 2], hull.back(), x) <= 0)
        hull.pop_back();
      hull.push_back(x);
    }
    hull.pop_back();
    std::reverse(q.begin(), q.end());
  }
  if (hull.size() < 3) return -1;
  double margin = 1e9;
  for (std::size_t i = 0; i < hull.size(); ++i) {
    const Eigen::Vector2d& a = hull[i];
    const Eigen::Vector2d& b = hull[(i + 1) % hull.size()];
    const double length = (b - a).norm();
    if (length < 1e-12) continue;
    margin = std::min(margin, cross(a, b, Eigen::Vector2d::Zero()) / length);
  }
  return margin;
}

std::vector<Eigen::Vector3d> OutermostPoints(const std::vector<Eigen::Vector3d>& points) {
  if (points.size() <= kHullDirections) return points;
  std::set<std::size_t> chosen;
  const double golden = M_PI * (3.0 - std::sqrt(5.0));
  for (int i = 0; i < kHullDirections; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / kHullDirections, r = std::sqrt(1.0 - z * z);
    const Eigen::Vector3d d(r * std::cos(golden * i), r * std::sin(golden * i), z);
    std::size_t best = 0;
    for (std::size_t k = 1; k < points.size(); ++k) {
      if (d.dot(points[k]) > d.dot(points[best])) best = k;
    }
    chosen.insert(best);
  }
  std::vector<Eigen::Vector3d> out;
  for (const std::size_t k : chosen) out.push_back(points[k]);
  return out;
}

// Tells the poses of round sides and thins them out. Largest margin first.
std::vector<StablePose> WithFewRolling(std::vector<StablePose> poses, double extent) {
  for (StablePose& p : poses) {
    p.rolls = p.margin_m < kRollMargin * extent &&
              std::any_of(poses.begin(), poses.end(), [&](const StablePose& other) {
                return &other != &p && other.up.dot(p.up) > kRollCos;
              });
  }
  for (double spacing = 0.0;; spacing += kRollStep) {
    LeaveIfStopped();
    std::vector<StablePose> kept;
    int rolling = 0;
    for (const StablePose& p : poses) {
      const bool near = p.rolls && spacing > 0.0 &&
                        std::any_of(kept.begin(), kept.end(), [&](const StablePose& other) {
                          return other.rolls && other.up.dot(p.up) > std::cos(spacing);
                        });
      if (near) continue;
      rolling += p.rolls;
      kept.push_back(p);
    }
    if (rolling <= kRollingPoses) return kept;
  }
}

}  // namespace

std::vector<StablePose> FindStablePoses(const TriangleMesh& mesh) {
  std::vector<StablePose> poses;
  if (mesh.vertices.size() < 4) return poses;
  Eigen::Vector3d low = mesh.vertices[0], high = mesh.vertices[0];
  for (const auto& v : mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  const double extent = (high - low).norm();
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> jitter(-kJitter * extent, kJitter * extent);
  std::vector<Eigen::Vector3d> points = OutermostPoints(mesh.vertices);
  for (auto& v : points) v += Eigen::Vector3d(jitter(rng), jitter(rng), jitter(rng));
  const Eigen::Vector3d mass = CenterOfMass(mesh);

  std::vector<Eigen::Vector3d> seen;
  for (const Facet& f : ConvexHull(points)) {
    LeaveIfStopped();
    if (f.normal.squaredNorm() < 0.5) continue;
    if (std::any_of(
            seen.begin(), seen.end(), [&](const auto& n) { return n.dot(f.normal) > kMergeCos; })) {
      continue;
    }
    // The facet's own normal carries jitter; the touching points define the plane's support
    // polygon.
    const Eigen::Vector3d u = f.normal.unitOrthogonal();
    const Eigen::Vector3d w = f.normal.cross(u);
    std::vector<Eigen::Vector2d> polygon;
    double offset = -1e9;
    for (const auto& v : mesh.vertices) offset = std::max(offset, f.normal.dot(v));
    for (const auto& v : mesh.vertices) {
      if (offset - f.normal.dot(v) > kTouch * extent) continue;
      polygon.emplace_back(u.dot(v - mass), w.dot(v - mass));
    }
    const double margin = polygon.size() < 3 ? -1 : InsideMargin(polygon);
    if (margin <= 0) continue;
    seen.push_back(f.normal);
    poses.push_back({-f.normal, offset, margin, false});
  }
  std::sort(poses.begin(), poses.end(), [](const auto& a, const auto& b) {
    return a.margin_m > b.margin_m;
  });
  return WithFewRolling(std::move(poses), extent);
}

}  // namespace horopter
