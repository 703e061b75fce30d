#include "server/vision/recognition/aspects/rendered_view.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/target_clones.h"

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr double kMarginPx = 4.0;  // background around the object, for windows of filters
// A window of more than this many squares of render_px belongs to a camera inside the object.
constexpr double kMaxSquares = 9.0;
// Nothing nearer than this share of the object's distance is drawn.
constexpr double kNearShare = 0.02;

struct Window {
  Vector2d low = Vector2d::Constant(1e30);
  Vector2d high = Vector2d::Constant(-1e30);
  void Add(const Vector2d& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
};

Vector2d Undistorted(const PinholeCamera& camera, const Vector2d& pixel) {
  if (camera.k1 == 0.0) return pixel;
  const Vector2d n = NormalizedPoint(camera, pixel);
  return {camera.focal_px * n.x() + camera.cx, camera.focal_px * n.y() + camera.cy};
}

Window ImageWindow(const PinholeCamera& camera) {
  Window w;
  for (const double x : {0.0, 0.5, 1.0}) {
    for (const double y : {0.0, 0.5, 1.0}) {
      w.Add(Undistorted(camera, {x * camera.width - 0.5, y * camera.height - 0.5}));
    }
  }
  return w;
}

// Vertices as u, v, 1 / z of the undistorted image.
std::vector<Vector3f> ProjectVertices(const RenderMesh& mesh,
                                      const PinholeCamera& camera,
                                      const Rigid3& pose,
                                      double near_m) {
  const Eigen::Matrix3f R = pose.R.cast<float>();
  // Relative to the object's centre, so that floats are exact enough far from the origin.
  const Vector3f t = (pose * mesh.center.cast<double>()).cast<float>();
  const auto f = static_cast<float>(camera.focal_px);
  const auto cx = static_cast<float>(camera.cx), cy = static_cast<float>(camera.cy);
  std::vector<Vector3f> out(mesh.vertices.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    const Vector3f p = R * (mesh.vertices[i] - mesh.center) + t;
    if (!(p.z() > static_cast<float>(near_m))) {
      out[i].setZero();
      continue;
    }
    const float w = 1.0f / p.z();
    out[i] = {f * p.x() * w + cx, f * p.y() * w + cy, w};
  }
  return out;
}

class Rasterizer {
 public:
  explicit Rasterizer(RenderedView* view) : view_(*view) {}

  // Pixels whose centres are inside or on the border, so that neighbours leave no gap: both compute
  // the same crossing, from the upper end of their common edge. Inlined into what is cloned.
  [[gnu::always_inline]] void Draw(int id,
                                   const Vector3f& p,
                                   const Vector3f& q,
                                   const Vector3f& r) {
    const Vector3f* a = &p;
    const Vector3f* b = &q;
    const Vector3f* c = &r;
    const auto below = [](const Vector3f* x, const Vector3f* y) {
      return x->y() > y->y() || (x->y() == y->y() && x->x() > y->x());
    };
    if (below(a, b)) std::swap(a, b);
    if (below(b, c)) std::swap(b, c);
    if (below(a, b)) std::swap(a, b);
    const int first = std::max(0, static_cast<int>(std::ceil(a->y())));
    const int last = std::min(view_.height - 1, static_cast<int>(std::floor(c->y())));
    // Most triangles of a fine mesh hold no pixel's centre.
    const float leftmost = std::min({a->x(), b->x(), c->x()});
    const float rightmost = std::max({a->x(), b->x(), c->x()});
    if (first > last || std::ceil(leftmost) > std::floor(rightmost)) return;
    const float area =
        (b->x() - a->x()) * (c->y() - a->y()) - (c->x() - a->x()) * (b->y() - a->y());
    float gu = 0.0f, gv = 0.0f;
    if (std::abs(area) > 1e-6f) {
      const float wb = b->z() - a->z(), wc = c->z() - a->z();
      gu = (wb * (c->y() - a->y()) - wc * (b->y() - a->y())) / area;
      gv = (wc * (b->x() - a->x()) - wb * (c->x() - a->x())) / area;
    }
    const float low = std::min({a->z(), b->z(), c->z()});
    const float high = std::max({a->z(), b->z(), c->z()});
    for (int y = first; y <= last; ++y) {
      const auto v = static_cast<float>(y);
      const float long_side = Crossing(*a, *c, v);
      const float short_side = v < b->y() ? Crossing(*a, *b, v) : Crossing(*b, *c, v);
      const float left = std::min(long_side, short_side);
      const float right = std::max(long_side, short_side);
      const int begin = std::max(0, static_cast<int>(std::ceil(left)));
      const int end = std::min(view_.width - 1, static_cast<int>(std::floor(right)));
      const float at_zero = a->z() + gv * (v - a->y()) - gu * a->x();
      float* depth = view_.inverse_depth.data() + static_cast<std::size_t>(y) * view_.width;
      std::int32_t* ids = view_.triangle.data() + static_cast<std::size_t>(y) * view_.width;
      for (int x = begin; x <= end; ++x) {
        // Slivers seen edge-on are steeper than the grid of pixels can tell.
        const float w = std::clamp(at_zero + gu * static_cast<float>(x), low, high);
        if (w > depth[x]) {
          depth[x] = w;
          ids[x] = id;
        }
      }
    }
  }

 private:
  [[gnu::always_inline]] static float Crossing(const Vector3f& upper,
                                               const Vector3f& lower,
                                               float v) {
    const float height = lower.y() - upper.y();
    if (!(height > 0.0f)) return upper.x();
    return upper.x() + (lower.x() - upper.x()) * ((v - upper.y()) / height);
  }

  RenderedView& view_;
};

// All triangles that face the camera, and which do.
HOROPTER_TARGET_CLONES
void DrawTriangles(const RenderMesh& mesh, Rendering* rendering) {
  Rendering& out = *rendering;
  out.facing.resize(mesh.triangles.size());
  Rasterizer rasterizer(&out.view);
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    const Eigen::Vector3i& t = mesh.triangles[i];
    const Vector3f& a = out.screen[t[0]];
    const Vector3f& b = out.screen[t[1]];
    const Vector3f& c = out.screen[t[2]];
    if (!(a.z() > 0.0f && b.z() > 0.0f && c.z() > 0.0f)) continue;
    const float area = (b.x() - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (b.y() - a.y());
    // Image y runs down: counter-clockwise from outside is a negative area.
    out.facing[i] = static_cast<std::int8_t>((area < 0.0f) - (area > 0.0f));
    if (mesh.closed && out.facing[i] <= 0) continue;
    rasterizer.Draw(static_cast<int>(i), a, b, c);
  }
}

// Size and place of the window; false if it is empty.
bool PlaceWindow(const std::vector<Vector3f>& vertices,
                 const PinholeCamera& camera,
                 double scale,
                 double render_px,
                 RenderedView* view) {
  Window object;
  for (const Vector3f& p : vertices) {
    if (p.z() > 0.0f) object.Add(p.head<2>().cast<double>());
  }
  const Window image = ImageWindow(camera);
  const Vector2d low = object.low.cwiseMax(image.low), high = object.high.cwiseMin(image.high);
  if (!((high - low).minCoeff() >= 0.0)) return false;
  const Vector2d size = high - low;
  const double most = kMaxSquares * render_px * render_px;
  scale = std::min(scale, std::sqrt(most / std::max(1e-12, size.x() * size.y())));
  scale = std::min(scale, 4.0 * kMaxSquares * render_px / size.maxCoeff());
  view->scale = scale;
  view->origin = low - Vector2d::Constant(kMarginPx / scale);
  view->width = static_cast<int>(std::ceil(size.x() * scale + 2.0 * kMarginPx)) + 1;
  view->height = static_cast<int>(std::ceil(size.y() * scale + 2.0 * kMarginPx)) + 1;
  const std::size_t pixels = static_cast<std::size_t>(view->width) * view->height;
  view->inverse_depth.assign(pixels, 0.0f);
  view->triangle.assign(pixels, -1);
  return true;
}

}  // namespace

RenderedFromImage::RenderedFromImage(const RenderedView& view, const PinholeCamera& camera)
    : camera_(camera), origin_(view.origin), scale_(view.scale) {
  if (camera.k1 == 0.0) return;
  const Vector2d center(camera.cx, camera.cy);
  double most = 1.0;
  for (const double x : {-0.5, camera.width - 0.5}) {
    for (const double y : {-0.5, camera.height - 0.5})
      most = std::max(most, (Vector2d(x, y) - center).squaredNorm());
  }
  steps_per_px2_ = (kRadialSteps - 1) / most;
  for (int i = 0; i < kRadialSteps; ++i) {
    const Vector2d pixel(camera.cx + std::sqrt(std::max(i, 1) / steps_per_px2_), camera.cy);
    factor_[i] = (Undistorted(camera, pixel) - center).x() / (pixel - center).x();
  }
  factor_[0] = 1.0;
}

Vector2d RenderedFromImage::operator()(const Vector2d& pixel) const {
  if (camera_.k1 == 0.0) return (pixel - origin_) * scale_;
  const Vector2d center(camera_.cx, camera_.cy);
  const double step = (pixel - center).squaredNorm() * steps_per_px2_;
  if (!(step < kRadialSteps - 1)) return (Undistorted(camera_, pixel) - origin_) * scale_;
  const int i = static_cast<int>(step);
  const double factor = factor_[i] + (step - i) * (factor_[i + 1] - factor_[i]);
  return (center + factor * (pixel - center) - origin_) * scale_;
}

Rendering Render(const RenderMesh& mesh,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 const RenderOptions& options) {
  Rendering out;
  const double z = (camera_from_object * mesh.center.cast<double>()).z();
  if (!(z > 0.0) || !(camera.focal_px > 0.0)) return out;
  out.screen = ProjectVertices(mesh, camera, camera_from_object, kNearShare * z);
  const double diameter_px = camera.focal_px * mesh.diameter_m / z;
  const double scale = std::min(options.max_scale, options.render_px / diameter_px);
  if (!PlaceWindow(out.screen, camera, scale, options.render_px, &out.view)) return out;
  const auto s = static_cast<float>(out.view.scale);
  const Eigen::Vector2f shift = (-out.view.origin * out.view.scale).cast<float>();
  for (Vector3f& p : out.screen) p.head<2>() = s * p.head<2>() + shift;
  out.focal_px = s * static_cast<float>(camera.focal_px);
  out.principal =
      ((Vector2d(camera.cx, camera.cy) - out.view.origin) * out.view.scale).cast<float>();
  DrawTriangles(mesh, &out);
  return out;
}

InverseDepthPlane PlaneOf(const Rendering& rendering, const RenderMesh& mesh, int triangle) {
  const Eigen::Vector3i& t = mesh.triangles[triangle];
  const Vector3f& a = rendering.screen[t[0]];
  const Vector3f ab = rendering.screen[t[1]] - a, ac = rendering.screen[t[2]] - a;
  const float area = ab.x() * ac.y() - ac.x() * ab.y();
  InverseDepthPlane plane;
  if (std::abs(area) > 1e-6f) {
    plane.gradient = {(ab.z() * ac.y() - ac.z() * ab.y()) / area,
                      (ac.z() * ab.x() - ab.z() * ac.x()) / area};
  }
  plane.at_zero = a.z() - plane.gradient.dot(a.head<2>());
  return plane;
}

}  // namespace horopter
