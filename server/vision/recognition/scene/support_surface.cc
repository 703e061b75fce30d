#include "server/vision/recognition/scene/support_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr double kSameHeightM = 0.004;  // one search covers both
// The carrying part may not be where it is thought to be, nor a vote where its part is.
constexpr double kDiscSlackM = 0.015;

}  // namespace

HeightRange HeightAbovePlane(const PreparedObject& object,
                             const Rigid3& scene_from_object,
                             const SupportingPlane& plane) {
  HeightRange range{1e9, -1e9};
  for (const auto& v : object.model.mesh.vertices) {
    const double h = plane.normal.dot(scene_from_object * v) - plane.offset_m;
    range.lowest_m = std::min(range.lowest_m, h);
    range.highest_m = std::max(range.highest_m, h);
  }
  return range;
}

Eigen::Vector2d Outline::Middle() const {
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : hull) middle += p / static_cast<double>(hull.size());
  return middle;
}

double Outline::Radius() const {
  const Eigen::Vector2d middle = Middle();
  double radius = 0.0;
  for (const Eigen::Vector2d& p : hull) radius = std::max(radius, (p - middle).norm());
  return radius;
}

Outline OutlineOnPlane(const PreparedObject& object,
                       const Rigid3& scene_from_object,
                       const SupportingPlane& plane) {
  Outline out;
  out.x = plane.normal.unitOrthogonal();
  out.y = plane.normal.cross(out.x);
  std::vector<Eigen::Vector2d> points;
  for (const Eigen::Vector3d& v : object.model.mesh.vertices) {
    const Eigen::Vector3d p = scene_from_object * v;
    points.push_back({out.x.dot(p), out.y.dot(p)});
  }
  std::sort(points.begin(), points.end(), [](const auto& a, const auto& b) {
    return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y();
  });
  const auto left_turn = [](const Eigen::Vector2d& a, const auto& b, const auto& c) {
    return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x()) > 0;
  };
  std::vector<Eigen::Vector2d>& hull = out.hull;  // monotone chain
  for (const bool upper : {false, true}) {
    const std::size_t first = hull.size();
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector2d& p = points[upper ? points.size() - 1 - i : i];
      while (hull.size() >= first + 2 && !left_turn(hull[hull.size() - 2], hull.back(), p))
        hull.pop_back();
      hull.push_back(p);
    }
    if (!hull.empty()) hull.pop_back();
  }
  return out;
}

bool LiesOver(const Outline& above, const Outline& below) {
  const Eigen::Vector2d middle = above.Middle();
  const auto& hull = below.hull;
  for (std::size_t i = 0; i < hull.size(); ++i) {
    const Eigen::Vector2d &a = hull[i], &b = hull[(i + 1) % hull.size()];
    const Eigen::Vector2d along = (b - a).normalized();
    if (along.x() * (middle.y() - a.y()) - along.y() * (middle.x() - a.x()) < -kOverhangM)
      return false;
  }
  return hull.size() > 2;
}

std::vector<SearchSurface> SearchSurfaces(const JointContext& context,
                                          const SceneModel& scene,
                                          std::span<const PlacedObject> doubtful,
                                          double doubtful_score,
                                          double plane_tolerance_m,
                                          int max_surfaces) {
  std::vector<SearchSurface> surfaces{{}};
  const auto add = [&](const PlacedObject& below, double top_m) {
    auto it = std::find_if(surfaces.begin(), surfaces.end(), [&](const SearchSurface& s) {
      return std::abs(s.height_m - top_m) < kSameHeightM;
    });
    if (it == surfaces.end()) {
      if (static_cast<int>(surfaces.size()) >= max_surfaces) return;
      it = surfaces.insert(it, {top_m, {}});
    } else if (it->discs.empty()) {
      return;  // the plane itself
    }
    const Outline outline =
        OutlineOnPlane(*context.objects[below.object], below.scene_from_object, *scene.plane);
    const Eigen::Vector2d middle = outline.Middle();
    it->discs.push_back({outline.x * middle.x() + outline.y * middle.y(),
                         outline.Radius() + kOverhangM + kDiscSlackM});
  };
  for (const PlacedObject& o : scene.objects) {
    add(o,
        HeightAbovePlane(*context.objects[o.object], o.scene_from_object, *scene.plane).highest_m);
  }
  for (const PlacedObject& p : doubtful) {
    if (p.score < doubtful_score) continue;
    const HeightRange range =
        HeightAbovePlane(*context.objects[p.object], p.scene_from_object, *scene.plane);
    if (std::abs(range.lowest_m) < plane_tolerance_m) add(p, range.highest_m);
  }
  return surfaces;
}

std::vector<SearchSurface> NotCovered(const std::vector<SearchSurface>& surfaces,
                                      const std::vector<SearchSurface>& searched) {
  const auto covers = [](const SearchSurface& by, const SearchSurface& s) {
    if (std::abs(by.height_m - s.height_m) >= kSameHeightM) return false;
    if (by.discs.empty() || s.discs.empty()) return by.discs.empty();
    return std::all_of(s.discs.begin(), s.discs.end(), [&](const SearchSurface::Disc& d) {
      return std::any_of(by.discs.begin(), by.discs.end(), [&](const SearchSurface::Disc& b) {
        return (d.center - b.center).norm() + d.radius_m < b.radius_m + kDiscSlackM;
      });
    });
  };
  std::vector<SearchSurface> out;
  for (const SearchSurface& s : surfaces) {
    if (std::none_of(
            searched.begin(), searched.end(), [&](const auto& by) { return covers(by, s); }))
      out.push_back(s);
  }
  return out;
}

}  // namespace horopter
