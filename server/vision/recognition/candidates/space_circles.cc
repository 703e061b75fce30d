#include "server/vision/recognition/candidates/space_circles.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "server/base/stop_scope.h"
#include "server/vision/recognition/scoring/circle_sighting.h"

namespace horopter {
namespace {

struct SightedArc {
  Eigen::Vector2d center;  // pixels
  double major_px = 0.0;
  Eigen::Vector3d ray;                    // unit, scene frame, from the eye to the centre
  std::array<Eigen::Vector3d, 2> normal;  // unit, towards the eye; seen alone it may be either
};

struct ArcView {
  Eigen::Vector3d eye;
  const FeatureView* view = nullptr;
  std::vector<SightedArc> arcs;
};

ArcView SightArcs(const FeatureView& view, const SpaceCircleOptions& options) {
  ArcView out;
  out.view = &view;
  out.eye = view.camera_from_scene.Inverse().t;
  const Eigen::Matrix3d scene_from_camera = view.camera_from_scene.R.transpose();
  for (const EllipseArc& arc : view.features->arcs) {
    if (!(arc.sweep_rad >= options.min_sweep_rad)) continue;
    if (!(arc.semi_minor_px * view.working_from_image >= options.min_minor_px)) continue;
    const std::optional<SightedCircle> circle = SightCircle(view.camera, arc);
    if (!circle) continue;
    out.arcs.push_back(
        {arc.center,
         arc.semi_major_px,
         scene_from_camera * circle->ray,
         {scene_from_camera * circle->normal[0], scene_from_camera * circle->normal[1]}});
  }
  return out;
}

Eigen::Vector3d CenterNearestToRays(const ArcView& a,
                                    const SightedArc& of_a,
                                    const ArcView& b,
                                    const SightedArc& of_b) {
  const double c = of_a.ray.dot(of_b.ray), det = 1.0 - c * c;
  const Eigen::Vector3d base = b.eye - a.eye;
  const double s = (of_a.ray.dot(base) - c * of_b.ray.dot(base)) / det;
  const double t = (c * of_a.ray.dot(base) - of_b.ray.dot(base)) / det;
  return 0.5 * (a.eye + s * of_a.ray + b.eye + t * of_b.ray);
}

// Radius that the arc gives a circle about the point; negative when the point is not before the
// camera or projects too far from the arc's centre.
double RadiusAt(const ArcView& view,
                const SightedArc& arc,
                const Eigen::Vector3d& point,
                double reach_px) {
  const Eigen::Vector3d p = view.view->camera_from_scene * point;
  if (!(p.z() > 1e-6)) return -1.0;
  const double miss = (Project(view.view->camera, p) - arc.center).norm();
  if (!(miss * view.view->working_from_image <= reach_px)) return -1.0;
  return arc.major_px * p.z() / view.view->camera.focal_px;
}

}  // namespace

std::vector<SpaceCircle> FindSpaceCircles(std::span<const FeatureView> views,
                                          const SpaceCircleOptions& options) {
  std::vector<ArcView> sighted;
  for (const FeatureView& view : views) sighted.push_back(SightArcs(view, options));
  const int n = static_cast<int>(sighted.size());
  const double min_cos = std::cos(options.normal_rad);
  std::vector<SpaceCircle> found;
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      for (const SightedArc& of_a : sighted[a].arcs) {
        LeaveIfStopped();
        for (const SightedArc& of_b : sighted[b].arcs) {
          if (of_a.ray.cross(of_b.ray).norm() < options.min_parallax_rad) continue;
          const Eigen::Vector3d center = CenterNearestToRays(sighted[a], of_a, sighted[b], of_b);
          const double ra = RadiusAt(sighted[a], of_a, center, options.reach_px);
          const double rb = RadiusAt(sighted[b], of_b, center, options.reach_px);
          if (!(ra > 0 && rb > 0) || std::abs(std::log(ra / rb)) > options.radius_log) continue;
          Eigen::Vector3d normal = Eigen::Vector3d::Zero();
          double best = min_cos;
          for (const Eigen::Vector3d& na : of_a.normal) {
            for (const Eigen::Vector3d& nb : of_b.normal) {
              if (na.dot(nb) < best) continue;
              best = na.dot(nb);
              normal = (na + nb).normalized();
            }
          }
          if (normal.isZero()) continue;
          SpaceCircle circle{center, normal, std::sqrt(ra * rb), 2};
          for (int c = 0; c < n; ++c) {
            if (c == a || c == b) continue;
            circle.views += std::any_of(
                sighted[c].arcs.begin(), sighted[c].arcs.end(), [&](const SightedArc& arc) {
                  const double r = RadiusAt(sighted[c], arc, center, options.reach_px);
                  return r > 0 && std::abs(std::log(r / circle.radius_m)) < options.radius_log &&
                         std::max(arc.normal[0].dot(normal), arc.normal[1].dot(normal)) > min_cos;
                });
          }
          found.push_back(circle);
        }
      }
    }
  }
  std::stable_sort(found.begin(), found.end(), [](const SpaceCircle& x, const SpaceCircle& y) {
    if (x.views != y.views) return x.views > y.views;
    return x.radius_m > y.radius_m;
  });
  std::vector<SpaceCircle> out;
  for (const SpaceCircle& circle : found) {
    LeaveIfStopped();
    if (static_cast<int>(out.size()) >= options.max_circles) break;
    if (std::none_of(out.begin(), out.end(), [&](const SpaceCircle& o) {
          return (o.center - circle.center).norm() < 0.1 * circle.radius_m &&
                 std::abs(std::log(o.radius_m / circle.radius_m)) < 0.5 * options.radius_log &&
                 o.normal.dot(circle.normal) > min_cos;
        })) {
      out.push_back(circle);
    }
  }
  return out;
}

}  // namespace horopter
