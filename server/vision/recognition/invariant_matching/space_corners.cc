#include "server/vision/recognition/invariant_matching/space_corners.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

constexpr double kMinPlaneAngleRad = 0.06;  // between the planes of rays that give a direction
constexpr int kMaxCorners = 400;            // those that most views show are kept
// An edge that ends in a junction: the plane of its rays and where its other end is.
struct CornerEdge {
  Eigen::Vector3d plane = Eigen::Vector3d::UnitX();      // unit normal, scene frame
  Eigen::Vector2d direction = Eigen::Vector2d::UnitX();  // unit, image, away from the corner
  Eigen::Vector3d far_ray = Eigen::Vector3d::UnitZ();    // scene frame
  int segment = -1;
};

struct CornerRay {
  Eigen::Vector2d pixel;
  Eigen::Vector3d ray;  // unit, scene frame
  std::vector<CornerEdge> edges;
  int junction = -1;
};

struct SightedView {
  Eigen::Vector3d eye;
  const FeatureView* view = nullptr;
  std::vector<CornerRay> corners;
};

Eigen::Vector3d RayOf(const FeatureView& view, const Eigen::Vector2d& pixel) {
  return (view.camera_from_scene.R.transpose() * NormalizedPoint(view.camera, pixel).homogeneous())
      .normalized();
}

// Ends on a passing segment say nothing of a corner in space: the other edge may lie behind.
SightedView Sight(const FeatureView& view) {
  SightedView out;
  out.view = &view;
  out.eye = view.camera_from_scene.Inverse().t;
  const ImageFeatures& f = *view.features;
  for (std::size_t j = 0; j < f.junctions.size(); ++j) {
    const Junction& junction = f.junctions[j];
    CornerRay corner{junction.point, RayOf(view, junction.point), {}, static_cast<int>(j)};
    for (const Junction::End& end : junction.ends) {
      if (end.interior) continue;
      const Segment& s = f.segments[end.segment];
      if (s.in_texture) continue;
      const Eigen::Vector2d& far = end.at_start ? s.end : s.start;
      CornerEdge edge;
      edge.far_ray = RayOf(view, far);
      edge.segment = end.segment;
      const Eigen::Vector3d normal = corner.ray.cross(edge.far_ray);
      if (!(normal.norm() > 1e-9) || (far - junction.point).norm() < 1e-6) continue;
      edge.plane = normal.normalized();
      edge.direction = (far - junction.point).normalized();
      corner.edges.push_back(edge);
    }
    if (corner.edges.size() >= 2) out.corners.push_back(std::move(corner));
  }
  return out;
}

// A view's junction that shows the point.
struct Shown {
  int view = -1;
  int corner = -1;
};

Eigen::Vector3d NearestToRays(std::span<const SightedView> views, std::span<const Shown> shown) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Shown& s : shown) {
    const Eigen::Vector3d& r = views[s.view].corners[s.corner].ray;
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - r * r.transpose();
    A += across;
    b += across * views[s.view].eye;
  }
  return A.ldlt().solve(b);
}

// Distance (working pixels) of the projected point from a junction; negative behind the camera.
double MissPx(const FeatureView& view, const Eigen::Vector3d& point, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d p = view.camera_from_scene * point;
  if (!(p.z() > 1e-6)) return -1.0;
  return (Project(view.camera, p) - pixel).norm() * view.working_from_image;
}

// The junction nearest to the projected point within reach; -1: none.
int JunctionAt(const SightedView& sighted, const Eigen::Vector3d& point, double reach_px) {
  const FeatureView& view = *sighted.view;
  const Eigen::Vector3d p = view.camera_from_scene * point;
  if (!(p.z() > 1e-6)) return -1;
  const Eigen::Vector2d u = Project(view.camera, p);
  double best = reach_px / view.working_from_image;
  int found = -1;
  for (int j = 0; j < static_cast<int>(sighted.corners.size()); ++j) {
    const Eigen::Vector2d off = sighted.corners[j].pixel - u;
    if (std::abs(off.x()) > best || std::abs(off.y()) > best) continue;
    const double distance = off.norm();
    if (distance < best) {
      best = distance;
      found = j;
    }
  }
  return found;
}

// Image direction of a direction in space at a point; zero when it points along the ray.
Eigen::Vector2d ImageDirection(const FeatureView& view,
                               const Eigen::Vector3d& point,
                               const Eigen::Vector3d& direction) {
  const Eigen::Vector3d p = view.camera_from_scene * point;
  const Eigen::Vector3d d = view.camera_from_scene.R * direction;
  const Eigen::Vector2d off = d.head<2>() - d.z() / p.z() * p.head<2>();
  const double norm = off.norm();
  return norm > 0.05 ? Eigen::Vector2d(off / norm) : Eigen::Vector2d::Zero();
}

// How far along the direction the edge's far end lies; negative when it cannot be said.
double LengthAlong(const Eigen::Vector3d& eye,
                   const Eigen::Vector3d& far_ray,
                   const Eigen::Vector3d& point,
                   const Eigen::Vector3d& direction) {
  const double c = far_ray.dot(direction), det = 1.0 - c * c;
  if (det < 1e-3) return -1.0;
  const Eigen::Vector3d off = eye - point;
  return (direction.dot(off) - c * far_ray.dot(off)) / det;
}

// The edges of a point that `needed` of its views agree about.
std::vector<SpaceCorner::Edge> AgreedEdges(std::span<const SightedView> views,
                                           std::span<const Shown> shown,
                                           const Eigen::Vector3d& point,
                                           int needed,
                                           const SpaceCornerOptions& options) {
  std::vector<SpaceCorner::Edge> out;
  const double min_cos = std::cos(options.direction_rad);
  for (std::size_t a = 0; a < shown.size(); ++a) {
    for (std::size_t b = a + 1; b < shown.size(); ++b) {
      for (const CornerEdge& e : views[shown[a].view].corners[shown[a].corner].edges) {
        for (const CornerEdge& f : views[shown[b].view].corners[shown[b].corner].edges) {
          const Eigen::Vector3d cross = e.plane.cross(f.plane);
          if (cross.norm() < kMinPlaneAngleRad) continue;
          Eigen::Vector3d direction = cross.normalized();
          if (ImageDirection(*views[shown[a].view].view, point, direction).dot(e.direction) < 0)
            direction = -direction;
          // All views' edges that agree give the direction together.
          Eigen::Matrix3d planes = Eigen::Matrix3d::Zero();
          std::vector<ShownFeature> agreeing;
          double length = 0.0;
          for (const Shown& s : shown) {
            const SightedView& view = views[s.view];
            const Eigen::Vector2d expected = ImageDirection(*view.view, point, direction);
            const CornerEdge* best = nullptr;
            double best_cos = min_cos;
            for (const CornerEdge& g : view.corners[s.corner].edges) {
              const double c = expected.dot(g.direction);
              if (c < best_cos) continue;
              best_cos = c;
              best = &g;
            }
            if (best == nullptr) continue;
            agreeing.push_back({s.view, best->segment});
            planes += best->plane * best->plane.transpose();
            length = std::max(length, LengthAlong(view.eye, best->far_ray, point, direction));
          }
          if (static_cast<int>(agreeing.size()) < needed || !(length > 0)) continue;
          const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(planes);
          const Eigen::Vector3d refined = solver.eigenvectors().col(0);
          direction = refined.dot(direction) < 0 ? Eigen::Vector3d(-refined) : refined;
          if (std::any_of(out.begin(), out.end(), [&](const SpaceCorner::Edge& o) {
                return o.direction.dot(direction) > min_cos;
              })) {
            continue;
          }
          out.push_back({direction, length, std::move(agreeing)});
        }
      }
    }
  }
  return out;
}

// The corner in space that two junctions show, if enough views agree on it and on its edges, and no
// pair of earlier views shows it.
std::optional<SpaceCorner> CornerOfPair(const std::vector<SightedView>& sighted,
                                        const Shown& first,
                                        const Shown& second,
                                        const SpaceCornerOptions& options) {
  const int n = static_cast<int>(sighted.size()), needed = std::min(3, n);
  std::vector<Shown> shown{first, second};
  Eigen::Vector3d point = NearestToRays(sighted, shown);
  for (int c = 0; c < n; ++c) {
    if (c == first.view || c == second.view) continue;
    const int k = JunctionAt(sighted[c], point, options.reach_px);
    if (k < 0) continue;
    // Pairs of later views find the same corners again: the first pair that shows it counts.
    if (c < first.view) return std::nullopt;
    shown.push_back({c, k});
  }
  if (static_cast<int>(shown.size()) < needed) return std::nullopt;
  point = NearestToRays(sighted, shown);
  for (const Shown& s : shown) {
    const double miss =
        MissPx(*sighted[s.view].view, point, sighted[s.view].corners[s.corner].pixel);
    if (miss < 0 || miss > options.reach_px) return std::nullopt;
  }
  SpaceCorner corner;
  corner.point = point;
  corner.edges = AgreedEdges(sighted, shown, point, needed, options);
  if (corner.edges.size() < 2) return std::nullopt;
  for (const Shown& s : shown)
    corner.junctions.push_back({s.view, sighted[s.view].corners[s.corner].junction});
  return corner;
}

}  // namespace

std::vector<SpaceCorner> FindSpaceCorners(std::span<const FeatureView> views,
                                          const SpaceCornerOptions& options) {
  std::vector<SightedView> sighted;
  for (const FeatureView& view : views) sighted.push_back(Sight(view));
  const int n = static_cast<int>(sighted.size());
  std::vector<SpaceCorner> found;
  if (n < 2) return found;
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      const Eigen::Vector3d base = sighted[b].eye - sighted[a].eye;
      const FeatureView& view_b = *sighted[b].view;
      const double px_b = view_b.camera.focal_px * view_b.working_from_image;
      for (int i = 0; i < static_cast<int>(sighted[a].corners.size()); ++i) {
        LeaveIfStopped();
        // The epipolar plane; its distance from a ray of b in pixels needs no epipolar line.
        const Eigen::Vector3d& ray = sighted[a].corners[i].ray;
        const Eigen::Vector3d plane = base.cross(ray);
        const double norm = plane.norm();
        if (!(norm > 1e-9)) continue;
        for (int j = 0; j < static_cast<int>(sighted[b].corners.size()); ++j) {
          const Eigen::Vector3d& other = sighted[b].corners[j].ray;
          if (std::abs(plane.dot(other)) * px_b > 2.0 * options.reach_px * norm) continue;
          if (ray.cross(other).norm() < options.min_parallax_rad) continue;
          if (auto corner = CornerOfPair(sighted, {a, i}, {b, j}, options))
            found.push_back(*std::move(corner));
        }
      }
    }
  }
  std::stable_sort(found.begin(), found.end(), [](const SpaceCorner& x, const SpaceCorner& y) {
    if (x.views() != y.views()) return x.views() > y.views();
    return x.edges.size() > y.edges.size();
  });
  std::vector<SpaceCorner> out;
  for (SpaceCorner& corner : found) {
    LeaveIfStopped();
    if (static_cast<int>(out.size()) >= kMaxCorners) break;
    if (std::none_of(out.begin(), out.end(), [&](const SpaceCorner& o) {
          return (o.point - corner.point).norm() < options.same_point_m;
        })) {
      out.push_back(std::move(corner));
    }
  }
  return out;
}

}  // namespace horopter
