#include "server/vision/recognition/interpretation/extra_circles.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/recognition/aspects/contour_ellipses.h"

namespace horopter {
namespace {

constexpr int kRimPoints = 12;
constexpr double kLeastRadius = 0.012, kMostRadius = 0.25;  // diameters
constexpr double kRoundness = 0.15;      // of the radius, by which a circle's points may be off it
constexpr double kFlat = 0.01;           // diameters: the face under the rim is one plane
constexpr double kExplainedPx = 3.5;     // working px to an edge of the part
constexpr double kMostExplained = 0.25;  // of the rim
constexpr double kSameRadius = 1.25, kSamePlace = 0.3;  // a ratio; radii
constexpr int kLeastViews = 2;

struct Rim {
  Eigen::Vector2d center;
  std::array<Eigen::Vector2d, kRimPoints> points;
};

Rim RimOf(const EllipseArc& e) {
  Rim out{e.center, {}};
  const Eigen::Rotation2Dd turn(e.angle_rad);
  for (int i = 0; i < kRimPoints; ++i) {
    const double s = 2.0 * std::numbers::pi * i / kRimPoints;
    out.points[i] = e.center + turn * Eigen::Vector2d(e.semi_major_px * std::cos(s),
                                                      e.semi_minor_px * std::sin(s));
  }
  return out;
}

// One view of the part.
class PartView {
 public:
  PartView(const AspectImage& image,
           const CalibratedCamera& view,
           const SeenPart& part,
           const VisibleEdges& edges,
           const DepthBuffer* hidden)
      : camera_(WorkingCamera(image, view.camera)),
        camera_from_object_(view.camera_from_scene * part.scene_from_object),
        mesh_(part.mesh),
        edges_(edges),
        hidden_(hidden),
        rendered_(edges.view, camera_) {}

  // The circle on the part's surface, if it is one and none of the part's edges.
  std::optional<ExtraCircle> OnSurface(const Rim& rim) const {
    const int triangle = TriangleAt(rim.center);
    if (triangle < 0 || IsExplained(rim)) return std::nullopt;
    const Eigen::Vector3d normal = mesh_.face_normals[triangle].cast<double>();
    const Eigen::Vector3d on = mesh_.vertices[mesh_.triangles[triangle][0]].cast<double>();
    const Eigen::Hyperplane<double, 3> face(normal, on);
    std::array<Eigen::Vector3d, kRimPoints> points;
    ExtraCircle out;
    for (int i = 0; i < kRimPoints; ++i) {
      const auto x = Intersect(rim.points[i], face);
      if (!x || !IsOnFace(rim.points[i], face)) return std::nullopt;
      points[i] = *x;
      out.place += *x / kRimPoints;
    }
    for (const Eigen::Vector3d& x : points) out.radius_m += (x - out.place).norm() / kRimPoints;
    for (const Eigen::Vector3d& x : points) {
      if (std::abs((x - out.place).norm() - out.radius_m) > kRoundness * out.radius_m)
        return std::nullopt;
    }
    if (out.radius_m < kLeastRadius * mesh_.diameter_m ||
        out.radius_m > kMostRadius * mesh_.diameter_m || IsBehindOthers(out.place))
      return std::nullopt;
    out.views = 1;
    return out;
  }

 private:
  int TriangleAt(const Eigen::Vector2d& pixel) const {
    const RenderedView& view = edges_.view;
    const Eigen::Vector2d at = rendered_(pixel);
    const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
    if (x < 0 || y < 0 || x >= view.width || y >= view.height) return -1;
    return view.triangle[static_cast<std::size_t>(y) * view.width + x];
  }

  bool IsOnFace(const Eigen::Vector2d& pixel, const Eigen::Hyperplane<double, 3>& face) const {
    const int triangle = TriangleAt(pixel);
    if (triangle < 0) return false;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d v = mesh_.vertices[mesh_.triangles[triangle][k]].cast<double>();
      if (face.absDistance(v) > kFlat * mesh_.diameter_m) return false;
    }
    return true;
  }

  std::optional<Eigen::Vector3d> Intersect(const Eigen::Vector2d& pixel,
                                           const Eigen::Hyperplane<double, 3>& face) const {
    const Eigen::Vector3d ray =
        camera_from_object_.R.transpose() * NormalizedPoint(camera_, pixel).homogeneous();
    const Eigen::Vector3d from = camera_from_object_.Inverse().t;
    const double along = face.normal().dot(ray);
    if (std::abs(along) < 1e-9 * ray.norm()) return std::nullopt;
    const double t = -face.signedDistance(from) / along;
    if (!(t > 0.0)) return std::nullopt;
    return from + t * ray;
  }

  bool IsExplained(const Rim& rim) const {
    int near = 0;
    for (const Eigen::Vector2d& p : rim.points) {
      near += std::any_of(
          edges_.points.begin(), edges_.points.end(), [&](const VisibleEdgePoint& edge) {
            return (edge.image.cast<double>() - p).squaredNorm() < kExplainedPx * kExplainedPx;
          });
    }
    return near > kMostExplained * kRimPoints;
  }

  bool IsBehindOthers(const Eigen::Vector3d& place) const {
    if (hidden_ == nullptr || hidden_->width == 0) return false;
    PinholeCamera straight = camera_;
    straight.k1 = 0.0;
    const Eigen::Vector3d x = camera_from_object_ * place;
    return !IsVisible(
        *hidden_, Project(straight, x), x.z(), kHiddenShareOfFaces * mesh_.diameter_m);
  }

  const PinholeCamera camera_;
  const Rigid3 camera_from_object_;
  const RenderMesh& mesh_;
  const VisibleEdges& edges_;
  const DepthBuffer* hidden_;
  const RenderedFromImage rendered_;
};

bool IsSame(const ExtraCircle& a, const ExtraCircle& b) {
  return std::max(a.radius_m, b.radius_m) < kSameRadius * std::min(a.radius_m, b.radius_m) &&
         (a.place - b.place).norm() < kSamePlace * std::min(a.radius_m, b.radius_m);
}

}  // namespace

std::vector<ExtraCircle> FindExtraCircles(std::span<const AspectImage> images,
                                          const std::vector<std::optional<CalibratedCamera>>& views,
                                          const SeenPart& part,
                                          std::span<const DepthBuffer> hidden) {
  std::vector<ExtraCircle> out;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || images[v].width == 0 || part.edges[v].points.empty()) continue;
    const PartView seen(
        images[v], *views[v], part, part.edges[v], v < hidden.size() ? &hidden[v] : nullptr);
    std::vector<ExtraCircle> here;  // each place once a view: a hole has more than one rim
    for (const EllipseArc& e : FindContourEllipses(images[v].contours)) {
      const auto circle = seen.OnSurface(RimOf(e));
      if (circle && std::none_of(here.begin(), here.end(), [&](const ExtraCircle& other) {
            return IsSame(*circle, other);
          }))
        here.push_back(*circle);
    }
    for (const ExtraCircle& circle : here) {
      const auto known = std::find_if(
          out.begin(), out.end(), [&](const ExtraCircle& other) { return IsSame(circle, other); });
      if (known == out.end()) {
        out.push_back(circle);
      } else {
        known->place += (circle.place - known->place) / ++known->views;
      }
    }
  }
  std::erase_if(out, [](const ExtraCircle& c) { return c.views < kLeastViews; });
  std::stable_sort(
      out.begin(), out.end(), [](const auto& a, const auto& b) { return a.views > b.views; });
  return out;
}

}  // namespace horopter
