#include "tests/support/rendered_scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <utility>

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr int kFine = 3;              // samples a pixel and direction
constexpr int kShadowSize = 640;      // pixels of a shadow map's side
constexpr int kTableLightSize = 768;  // of the table's light
// The table is lit as far from the origin as this many radii; beyond, as there.
constexpr double kLitRadii = 2.0;
constexpr double kNearM = 0.02;  // nothing is nearer to a camera
constexpr float kDisplayGamma = 2.2f;
constexpr double kMiddleGrey = 0.5;  // of what is displayed

// Across a surface a shadow map's pixel is this wide; points are lifted by as much.
double ShadowPixel(double radius_m) {
  return 2.0 * radius_m / kShadowSize;
}

Rigid3 LookAt(const Vector3d& from, const Vector3d& to) {
  const Vector3d z = (to - from).normalized();
  const Vector3d side = std::abs(z.z()) < 0.9 ? Vector3d(0, 0, 1) : Vector3d(0, 1, 0);
  const Vector3d x = z.cross(side).normalized();
  Rigid3 out;
  out.R.row(0) = x.transpose();
  out.R.row(1) = z.cross(x).transpose();
  out.R.row(2) = z.transpose();
  out.t = -(out.R * from);
  return out;
}

int Mirrored(int i, int n) {
  i = ((i % (2 * n)) + 2 * n) % (2 * n);
  return i < n ? i : 2 * n - 1 - i;
}

Vector3f Sample(const cv::Mat_<cv::Vec3f>& image, double u, double v, bool mirrored) {
  if (!mirrored) {
    u = std::clamp(u, 0.0, image.cols - 1.0);
    v = std::clamp(v, 0.0, image.rows - 1.0);
  }
  const double fu = std::floor(u), fv = std::floor(v);
  const auto a = static_cast<float>(u - fu), b = static_cast<float>(v - fv);
  const int x0 = Mirrored(static_cast<int>(fu), image.cols);
  const int x1 = Mirrored(static_cast<int>(fu) + 1, image.cols);
  const int y0 = Mirrored(static_cast<int>(fv), image.rows);
  const int y1 = Mirrored(static_cast<int>(fv) + 1, image.rows);
  const cv::Vec3f c = (1 - b) * ((1 - a) * image(y0, x0) + a * image(y0, x1)) +
                      b * ((1 - a) * image(y1, x0) + a * image(y1, x1));
  return {c[0], c[1], c[2]};
}

}  // namespace

absl::StatusOr<RenderMesh> ExactRenderMesh(const TriangleMesh& mesh, double diameter_m) {
  RenderMeshOptions options;
  options.tolerance = options.coarse_tolerance = 1e-5;  // a micrometre: the mesh as it is
  return MakeRenderMesh(mesh, diameter_m, options);
}

// The undistorted image, kFine samples a pixel, larger than the image by what the lens bends in.
struct SceneRenderer::Canvas {
  int width = 0, height = 0;
  double focal = 0.0, cx = 0.0, cy = 0.0;
  std::vector<float> inverse_depth;
  std::vector<std::int16_t> part;  // -1: the table
  std::vector<std::int32_t> triangle;
  std::vector<std::size_t> whole;  // samples of each part alone, nothing before it
  cv::Mat_<cv::Vec3f> light;

  std::size_t At(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
  Vector3d Ray(double x, double y) const { return {(x - cx) / focal, (y - cy) / focal, 1.0}; }
  // Where a pixel of the image came from.
  Vector2d FromImage(const PinholeCamera& camera, const Vector2d& pixel) const {
    const Vector2d n = NormalizedPoint(camera, pixel);
    return {focal * n.x() + cx, focal * n.y() + cy};
  }

  // Samples whose centres are inside the triangle; marks: a part's own silhouette.
  void Fill(int of_model, int id, const Vector3d p[3], std::vector<bool>* marks) {
    const double area = (p[1].x() - p[0].x()) * (p[2].y() - p[0].y()) -
                        (p[2].x() - p[0].x()) * (p[1].y() - p[0].y());
    if (std::abs(area) < 1e-12) return;
    const auto bound = [](double v, int n) {
      return std::clamp(static_cast<int>(std::ceil(v)), 0, n);
    };
    const int y0 = bound(std::min({p[0].y(), p[1].y(), p[2].y()}), height);
    const int y1 = bound(std::max({p[0].y(), p[1].y(), p[2].y()}), height);
    for (int y = y0; y < y1; ++y) {
      double low = 1e30, high = -1e30;
      for (int k = 0; k < 3; ++k) {
        const Vector3d &a = p[k], &b = p[(k + 1) % 3];
        if ((a.y() <= y) == (b.y() <= y)) continue;
        // From the upper end, so that neighbours find the same crossing.
        const Vector3d &upper = a.y() < b.y() ? a : b, &lower = a.y() < b.y() ? b : a;
        const double x =
            upper.x() + (lower.x() - upper.x()) * (y - upper.y()) / (lower.y() - upper.y());
        low = std::min(low, x);
        high = std::max(high, x);
      }
      for (int x = bound(low, width); x < bound(high, width); ++x) {
        const double b =
            ((x - p[0].x()) * (p[2].y() - p[0].y()) - (p[2].x() - p[0].x()) * (y - p[0].y())) /
            area;
        const double c =
            ((p[1].x() - p[0].x()) * (y - p[0].y()) - (x - p[0].x()) * (p[1].y() - p[0].y())) /
            area;
        const auto w = static_cast<float>((1 - b - c) * p[0].z() + b * p[1].z() + c * p[2].z());
        const std::size_t at = At(x, y);
        (*marks)[at] = true;
        if (w <= inverse_depth[at]) continue;
        inverse_depth[at] = w;
        part[at] = static_cast<std::int16_t>(of_model);
        triangle[at] = id;
      }
    }
  }
};

SceneRenderer::SceneRenderer(PaintedScene scene) : scene_(std::move(scene)) {
  for (const LightSource& light : scene_.lights) {
    ShadowMap map;
    map.camera_from_world = LookAt(light.position, Vector3d::Zero());
    const double distance = light.position.norm();
    const double focal = 0.5 * kShadowSize * (distance - scene_.radius_m) / scene_.radius_m;
    map.camera = CenteredCamera(kShadowSize, kShadowSize, focal);
    map.depth = MakeDepthBuffer(kShadowSize, kShadowSize);
    for (const PaintedPart& part : scene_.parts) {
      TriangleMesh mesh;
      for (const Vector3f& p : part.mesh->vertices) mesh.vertices.push_back(p.cast<double>());
      mesh.triangles = part.mesh->triangles;
      RenderDepth(mesh, map.camera, map.camera_from_world * part.world_from_object, &map.depth);
    }
    shadows_.push_back(std::move(map));
  }
  table_light_.create(kTableLightSize, kTableLightSize);
  const double step = 2.0 * kLitRadii * scene_.radius_m / (kTableLightSize - 1);
  for (int y = 0; y < kTableLightSize; ++y) {
    for (int x = 0; x < kTableLightSize; ++x) {
      const double half = 0.5 * (kTableLightSize - 1);
      const Vector3f light = TableLight({(x - half) * step, (y - half) * step, 0.0});
      table_light_(y, x) = {light.x(), light.y(), light.z()};
    }
  }
}

float SceneRenderer::Reaches(const ShadowMap& map, const Vector3d& point, double bias_m) const {
  const Vector3d p = map.camera_from_world * point;
  const Vector2d at = Project(map.camera, p);
  const double fu = std::floor(at.x()), fv = std::floor(at.y());
  const int x = static_cast<int>(fu), y = static_cast<int>(fv);
  if (x < 0 || y < 0 || x + 1 >= map.depth.width || y + 1 >= map.depth.height) return 1.0f;
  const auto lit = [&](int dx, int dy) {
    return p.z() <= map.depth.At(x + dx, y + dy) + bias_m ? 1.0f : 0.0f;
  };
  const auto a = static_cast<float>(at.x() - fu), b = static_cast<float>(at.y() - fv);
  return (1 - b) * ((1 - a) * lit(0, 0) + a * lit(1, 0)) +
         b * ((1 - a) * lit(0, 1) + a * lit(1, 1));
}

Vector3f SceneRenderer::TableLight(const Vector3d& point) const {
  Vector3f sum = Vector3f::Zero();
  for (std::size_t i = 0; i < shadows_.size(); ++i) {
    const LightSource& light = scene_.lights[i];
    const Vector3d to_light = light.position - point;
    const double squared = to_light.squaredNorm();
    const double weight =
        to_light.z() / std::sqrt(squared) * light.position.squaredNorm() / squared;
    if (weight <= 0.0) continue;
    sum += static_cast<float>(weight) * Reaches(shadows_[i], point, 0.0) * light.radiance;
  }
  return sum;
}

Vector3f SceneRenderer::PartLight(const PaintedPart& part,
                                  const Vector3d& point,
                                  const Vector3d& normal,
                                  const Vector3d& to_camera) const {
  Vector3f out = Vector3f::Zero();
  const double pixel = ShadowPixel(scene_.radius_m);
  const Vector3d lifted = point + 1.5 * pixel * normal;
  for (std::size_t i = 0; i < shadows_.size(); ++i) {
    const LightSource& light = scene_.lights[i];
    const Vector3d to_light = light.position - point;
    const double squared = to_light.squaredNorm();
    const Vector3d l = to_light / std::sqrt(squared);
    const double cosine = normal.dot(l);
    if (cosine <= 0.0) continue;
    const auto falloff = static_cast<float>(light.position.squaredNorm() / squared);
    const Vector3f reaching = Reaches(shadows_[i], lifted, pixel) * falloff * light.radiance;
    out += static_cast<float>(cosine) * reaching.cwiseProduct(part.color);
    if (!light.highlights) continue;
    const double half = std::max(0.0, normal.dot((l + to_camera).normalized()));
    out += part.gloss * std::pow(static_cast<float>(half), part.shininess) * reaching;
  }
  // What the table sends up, of the colour of its middle.
  const cv::Vec3f table = scene_.table.reflectance(scene_.table.reflectance.rows / 2,
                                                   scene_.table.reflectance.cols / 2);
  const auto below = static_cast<float>(0.25 * (1.0 - normal.z()));
  out += below * part.color.cwiseProduct(Vector3f(table[0], table[1], table[2]));
  return out;
}

SceneRenderer::Canvas SceneRenderer::Draw(const PinholeCamera& camera,
                                          const Rigid3& camera_from_world) const {
  Canvas canvas;
  canvas.focal = kFine * camera.focal_px;
  Vector2d low = Vector2d::Constant(1e30), high = -low;
  for (const double x : {0.0, 0.5, 1.0}) {
    for (const double y : {0.0, 0.5, 1.0}) {
      const Vector2d n = NormalizedPoint(camera, {x * camera.width - 0.5, y * camera.height - 0.5});
      low = low.cwiseMin(canvas.focal * n);
      high = high.cwiseMax(canvas.focal * n);
    }
  }
  // Silhouettes are counted on a canvas an eighth larger on each side.
  const Vector2d margin = 0.125 * (high - low);
  canvas.width = static_cast<int>(std::ceil(high.x() - low.x() + 2.0 * margin.x()));
  canvas.height = static_cast<int>(std::ceil(high.y() - low.y() + 2.0 * margin.y()));
  canvas.cx = margin.x() - low.x();
  canvas.cy = margin.y() - low.y();
  const std::size_t n = static_cast<std::size_t>(canvas.width) * canvas.height;
  canvas.inverse_depth.assign(n, 0.0f);
  canvas.part.assign(n, -1);
  canvas.triangle.assign(n, -1);
  for (std::size_t i = 0; i < scene_.parts.size(); ++i) {
    const RenderMesh& mesh = *scene_.parts[i].mesh;
    const Rigid3 pose = camera_from_world * scene_.parts[i].world_from_object;
    std::vector<Vector3d> screen;
    for (const Vector3f& v : mesh.vertices) {
      const Vector3d p = pose * v.cast<double>();
      const double w = p.z() > kNearM ? 1.0 / p.z() : 0.0;
      screen.emplace_back(
          canvas.focal * p.x() * w + canvas.cx, canvas.focal * p.y() * w + canvas.cy, w);
    }
    std::vector<bool> marks(n, false);
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
      const Eigen::Vector3i& v = mesh.triangles[t];
      const Vector3d corners[3] = {screen[v[0]], screen[v[1]], screen[v[2]]};
      if (corners[0].z() == 0.0 || corners[1].z() == 0.0 || corners[2].z() == 0.0) continue;
      canvas.Fill(static_cast<int>(i), static_cast<int>(t), corners, &marks);
    }
    canvas.whole.push_back(static_cast<std::size_t>(std::count(marks.begin(), marks.end(), true)));
  }
  return canvas;
}

namespace {

// Unit normal of a triangle's smooth surface at a point of its plane, object frame.
Vector3d NormalAt(const RenderMesh& mesh, int triangle, const Vector3d& point) {
  if (mesh.flat[triangle]) return mesh.face_normals[triangle].cast<double>();
  const Eigen::Vector3i& t = mesh.triangles[triangle];
  const Vector3d a = mesh.vertices[t[0]].cast<double>();
  const Vector3d ab = mesh.vertices[t[1]].cast<double>() - a;
  const Vector3d ac = mesh.vertices[t[2]].cast<double>() - a;
  const Vector3d n = ab.cross(ac), ap = point - a;
  const double squared = std::max(1e-30, n.squaredNorm());
  const double b = std::clamp(n.dot(ap.cross(ac)) / squared, 0.0, 1.0);
  const double c = std::clamp(n.dot(ab.cross(ap)) / squared, 0.0, 1.0 - b);
  const auto& corner = mesh.normals[triangle];
  return ((1 - b - c) * corner[0].cast<double>() + b * corner[1].cast<double>() +
          c * corner[2].cast<double>())
      .normalized();
}

}  // namespace

void SceneRenderer::Shade(const Rigid3& camera_from_world, Canvas* canvas) const {
  canvas->light.create(canvas->height, canvas->width);
  const Rigid3 world_from_camera = camera_from_world.Inverse();
  const Vector3d& center = world_from_camera.t;
  const double texel = scene_.table.size_m / scene_.table.reflectance.cols;
  const double lit = 2.0 * kLitRadii * scene_.radius_m / (kTableLightSize - 1);
  for (int y = 0; y < canvas->height; ++y) {
    for (int x = 0; x < canvas->width; ++x) {
      const Vector3d ray = world_from_camera.R * canvas->Ray(x, y);
      const std::size_t at = canvas->At(x, y);
      Vector3f light = Vector3f::Constant(0.1f);  // above the horizon
      if (const int i = canvas->part[at]; i >= 0) {
        const PaintedPart& part = scene_.parts[i];
        const Vector3d point = center + ray / static_cast<double>(canvas->inverse_depth[at]);
        const Vector3d in_object = part.world_from_object.Inverse() * point;
        Vector3d normal =
            part.world_from_object.R * NormalAt(*part.mesh, canvas->triangle[at], in_object);
        const Vector3d to_camera = -ray.normalized();
        if (normal.dot(to_camera) < 0.0 && !part.mesh->closed) normal = -normal;
        light = PartLight(part, point, normal, to_camera);
      } else if (ray.z() < -1e-3) {
        const Vector3d point = center - ray * (center.z() / ray.z());
        const Vector3f reflectance = Sample(scene_.table.reflectance,
                                            point.x() / texel + 0.5 * scene_.table.reflectance.cols,
                                            point.y() / texel + 0.5 * scene_.table.reflectance.rows,
                                            true);
        light = reflectance.cwiseProduct(Sample(table_light_,
                                                point.x() / lit + 0.5 * (kTableLightSize - 1),
                                                point.y() / lit + 0.5 * (kTableLightSize - 1),
                                                false));
      }
      canvas->light(y, x) = {light.z(), light.y(), light.x()};
    }
  }
}

void SceneRenderer::Measure(const Canvas& canvas,
                            const PinholeCamera& camera,
                            Photograph* out) const {
  const std::size_t n = scene_.parts.size();
  std::vector<std::size_t> visible(n, 0);
  std::vector<cv::Point> low(n, {camera.width, camera.height}), high(n, {-1, -1});
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      const Vector2d p = canvas.FromImage(camera, Vector2d(u, v));
      const int x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
      if (x < 0 || y < 0 || x >= canvas.width || y >= canvas.height) continue;
      const int i = canvas.part[canvas.At(x, y)];
      if (i < 0) continue;
      ++visible[i];
      low[i] = {std::min(low[i].x, u), std::min(low[i].y, v)};
      high[i] = {std::max(high[i].x, u), std::max(high[i].y, v)};
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    const double whole = static_cast<double>(canvas.whole[i]) / (kFine * kFine);
    out->visible_share.push_back(
        whole > 0.0 ? std::min(1.0, static_cast<double>(visible[i]) / whole) : 0.0);
    out->visible_box.push_back(visible[i] > 0 ? cv::Rect(low[i], high[i] + cv::Point(1, 1))
                                              : cv::Rect(-1, -1, -1, -1));
  }
}

Photograph SceneRenderer::Take(const PinholeCamera& camera,
                               const Rigid3& camera_from_world,
                               const CameraLook& look) const {
  Photograph out;
  Canvas canvas = Draw(camera, camera_from_world);
  Shade(camera_from_world, &canvas);
  Measure(canvas, camera, &out);
  // Through the lens.
  cv::Mat_<cv::Vec2f> from(camera.height * kFine, camera.width * kFine);
  for (int y = 0; y < from.rows; ++y) {
    for (int x = 0; x < from.cols; ++x) {
      const Vector2d p =
          canvas.FromImage(camera, {(x + 0.5) / kFine - 0.5, (y + 0.5) / kFine - 0.5});
      from(y, x) = {static_cast<float>(p.x()), static_cast<float>(p.y())};
    }
  }
  cv::Mat fine, light;
  cv::remap(canvas.light, fine, from, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  cv::resize(fine, light, {camera.width, camera.height}, 0, 0, cv::INTER_AREA);
  if (look.blur_px > 0.0) cv::GaussianBlur(light, light, {}, look.blur_px);
  // Onto the sensor: most noise is the light's own.
  cv::RNG rng(look.seed);
  out.image.create(camera.height, camera.width, CV_8UC3);
  const double at_middle = std::pow(kMiddleGrey, kDisplayGamma);
  // Noise of the light that is `noise` grey levels on display at middle grey.
  const double noise = look.noise / 255.0 * kDisplayGamma * at_middle / kMiddleGrey;
  for (int y = 0; y < light.rows; ++y) {
    for (int x = 0; x < light.cols; ++x) {
      const cv::Vec3f& l = light.at<cv::Vec3f>(y, x);
      cv::Vec3b& to = out.image.at<cv::Vec3b>(y, x);
      for (int c = 0; c < 3; ++c) {
        const double clean = std::max(0.0f, l[c] * look.exposure * look.gains[2 - c]);
        const double share = 0.2 + 0.8 * clean / at_middle;  // a fifth is the sensor's
        const double seen = std::clamp(clean + rng.gaussian(noise * std::sqrt(share)), 0.0, 1.0);
        to[c] = cv::saturate_cast<uchar>(255.0 * std::pow(seen, 1.0 / kDisplayGamma));
      }
    }
  }
  return out;
}

}  // namespace horopter
