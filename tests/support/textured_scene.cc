#include "tests/support/textured_scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kTextureSide = 1024;
constexpr int kBounces = 2;     // of a ray from mirror to mirror
constexpr double kNear = 1e-6;  // metres: a reflected ray does not hit where it starts

double At(const cv::Mat& texture, double x, double y) {
  const auto wrap = [](int i, int n) { return ((i % n) + n) % n; };
  const int i = static_cast<int>(std::floor(x)), k = static_cast<int>(std::floor(y));
  const double fx = x - i, fy = y - k;
  const int x0 = wrap(i, texture.cols), x1 = wrap(i + 1, texture.cols);
  const float* low = texture.ptr<float>(wrap(k, texture.rows));
  const float* high = texture.ptr<float>(wrap(k + 1, texture.rows));
  return (1 - fy) * ((1 - fx) * low[x0] + fx * low[x1]) +
         fy * ((1 - fx) * high[x0] + fx * high[x1]);
}

// A rectangle in the world of one view, prepared for rays.
struct Facet {
  Vector3d corner, normal, u, v;  // unit vectors
  double length_u, length_v, texel_m;
  const cv::Mat* texture;
  bool mirrors;
};

std::vector<Facet> FacetsOf(const TexturedScene& scene, int view) {
  std::vector<Facet> facets;
  for (size_t b = 0; b < scene.bodies.size(); ++b) {
    const std::vector<Rigid3>& moved = scene.views[view].world_from_body;
    const Rigid3 world_from_body = moved.empty() ? Rigid3() : moved[b];
    for (const TexturedRectangle& r : scene.bodies[b]) {
      const cv::Mat* texture =
          r.screen.empty() ? &r.texture : &r.screen[static_cast<size_t>(view) % r.screen.size()];
      const Vector3d u = world_from_body.R * r.u.normalized();
      const Vector3d v = world_from_body.R * r.v.normalized();
      facets.push_back({world_from_body * r.corner,
                        u.cross(v),
                        u,
                        v,
                        r.u.norm(),
                        r.v.norm(),
                        r.texel_m,
                        texture,
                        r.mirrors});
    }
  }
  return facets;
}

double Radiance(const std::vector<Facet>& facets, double background, Vector3d from, Vector3d ray) {
  for (int bounce = 0; bounce <= kBounces; ++bounce) {
    double nearest = std::numeric_limits<double>::infinity();
    const Facet* hit = nullptr;
    double at_u = 0.0, at_v = 0.0;
    for (const Facet& f : facets) {
      const double t = f.normal.dot(f.corner - from) / f.normal.dot(ray);
      if (!(t > kNear) || t >= nearest) continue;
      const Vector3d on = from + t * ray - f.corner;
      const double a = on.dot(f.u), b = on.dot(f.v);
      if (a < 0.0 || b < 0.0 || a > f.length_u || b > f.length_v) continue;
      nearest = t;
      hit = &f;
      at_u = a;
      at_v = b;
    }
    if (hit == nullptr) return background;
    if (!hit->mirrors) return At(*hit->texture, at_u / hit->texel_m, at_v / hit->texel_m);
    from += nearest * ray;
    ray -= 2.0 * ray.dot(hit->normal) * hit->normal;
  }
  return background;
}

Rigid3 AtRow(const TexturedView& view, double row) {
  const double share = row / std::max(view.camera.height - 1, 1) - 0.5;
  const Vector3d w = share * view.row_turn_rad;
  Rigid3 step;
  if (w.norm() > 0.0) step.R = Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
  step.t = share * view.row_move_m;
  return step * view.camera_from_world;
}

Rigid3 Looking(const Vector3d& eye, const Vector3d& target) {
  const Vector3d z = (target - eye).normalized();
  const Vector3d x = z.cross(Vector3d::UnitZ()).normalized();
  Rigid3 pose;
  pose.R.row(0) = x;
  pose.R.row(1) = z.cross(x);
  pose.R.row(2) = z;
  pose.t = -(pose.R * eye);
  return pose;
}

Vector3d OnArc(double azimuth, double height_rad, double distance_m) {
  return distance_m * Vector3d(std::cos(height_rad) * std::sin(azimuth),
                               -std::cos(height_rad) * std::cos(azimuth),
                               std::sin(height_rad));
}

TexturedRectangle Rectangle(const Vector3d& corner,
                            const Vector3d& u,
                            const Vector3d& v,
                            const cv::Mat& texture) {
  TexturedRectangle r;
  r.corner = corner;
  r.u = u;
  r.v = v;
  r.texture = texture;
  return r;
}

TexturedRectangle Floor(const cv::Mat& texture, double side_m = 1.6) {
  return Rectangle(
      {-0.5 * side_m, -0.5 * side_m, 0.0}, {side_m, 0.0, 0.0}, {0.0, side_m, 0.0}, texture);
}

TexturedBody Boxes(int count, double radius_m, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  TexturedBody boxes;
  for (int k = 0; k < count; ++k) {
    const double around = 2.0 * M_PI * (k + 0.3 * u(rng)) / count;
    const double out = count > 1 ? radius_m * (0.6 + 0.4 * u(rng)) : 0.0;
    const TexturedBody box =
        TexturedBox({out * std::cos(around), out * std::sin(around), 0.0},
                    {0.07 + 0.05 * u(rng), 0.07 + 0.05 * u(rng), 0.05 + 0.1 * u(rng)},
                    M_PI * u(rng),
                    seed * 31 + static_cast<unsigned>(k));
    boxes.insert(boxes.end(), box.begin(), box.end());
  }
  return boxes;
}

// One camera for all views.
TexturedScene FromStandingCamera(int views) {
  TexturedScene scene;
  TexturedView view;
  view.camera = CenteredCamera(640, 480, 1.3 * 640);
  view.camera_from_world = Looking(OnArc(0.1, 0.5, 0.75), {0.0, 0.0, 0.03});
  view.world_from_body.resize(2);
  scene.views.assign(static_cast<size_t>(views), view);
  return scene;
}

TexturedRectangle Wall(unsigned seed) {
  return Rectangle({-1.2, 0.35, -0.2}, {2.4, 0.0, 0.0}, {0.0, 0.0, 1.4}, BlobTexture(seed));
}

}  // namespace

cv::Mat BlobTexture(unsigned seed, double contrast) {
  cv::RNG rng(seed * 7919ULL + 17);
  cv::Mat sum = cv::Mat::zeros(kTextureSide, kTextureSide, CV_32F);
  for (const double sigma : {1.3, 2.6, 6.0, 14.0}) {
    // Drawn small and enlarged, which is a blur of its own.
    const int side = static_cast<int>(kTextureSide / sigma);
    cv::Mat noise(side, side, CV_32F), large;
    rng.fill(noise, cv::RNG::NORMAL, 0.0, 1.0);
    cv::resize(noise, large, sum.size(), 0, 0, cv::INTER_CUBIC);
    sum += large;
  }
  cv::Mat mean, deviation;
  cv::meanStdDev(sum, mean, deviation);
  sum = (sum - mean.at<double>(0)) * (contrast / deviation.at<double>(0)) + 128.0;
  return cv::max(cv::min(sum, 255.0), 0.0);
}

cv::Mat CheckerTexture(int cells, int cell) {
  cv::Mat out(cells * cell, cells * cell, CV_32F);
  for (int y = 0; y < out.rows; ++y) {
    for (int x = 0; x < out.cols; ++x) {
      out.at<float>(y, x) = (x / cell + y / cell) % 2 == 0 ? 35.0f : 215.0f;
    }
  }
  return out;
}

cv::Mat MarkerTexture(int cells, bool alike, unsigned seed) {
  constexpr int kBits = 6, kBit = 5, kQuiet = 10;  // texels a bit, and between markers
  constexpr int kMarker = (kBits + 2) * kBit, kPitch = kMarker + kQuiet;
  cv::Mat out(cells * kPitch, cells * kPitch, CV_32F, cv::Scalar(215));
  std::mt19937 rng(seed);
  for (int k = 0; k < cells * cells; ++k) {
    if (alike) rng.seed(seed);
    const int left = k % cells * kPitch + kQuiet / 2, top = k / cells * kPitch + kQuiet / 2;
    out(cv::Rect(left, top, kMarker, kMarker)) = cv::Scalar(35);
    for (int bit = 0; bit < kBits * kBits; ++bit) {
      if (rng() % 2 == 0) continue;
      out(cv::Rect(left + (1 + bit % kBits) * kBit, top + (1 + bit / kBits) * kBit, kBit, kBit)) =
          cv::Scalar(215);
    }
  }
  return out;
}

TexturedBody TexturedBox(const Vector3d& centre_on_plane,
                         const Vector3d& size_m,
                         double turn_rad,
                         unsigned seed) {
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(turn_rad, Vector3d::UnitZ()).toRotationMatrix();
  const Vector3d x = turn.col(0) * size_m.x(), y = turn.col(1) * size_m.y(),
                 z = Vector3d::UnitZ() * size_m.z();
  const Vector3d low = centre_on_plane - 0.5 * (x + y);
  // Faces differ in brightness too, as in light from one side.
  const auto print = [&](unsigned face) -> cv::Mat {
    return BlobTexture(seed * 11 + face, 32.0) + 18.0 * (2.0 - face);
  };
  return {Rectangle(low + z, x, y, print(0)),
          Rectangle(low, x, z, print(1)),
          Rectangle(low, y, z, print(2)),
          Rectangle(low + y, x, z, print(3)),
          Rectangle(low + x, y, z, print(4))};
}

Rigid3 TexturedScene::CameraFromBody(int view, int body) const {
  const TexturedView& v = views[static_cast<size_t>(view)];
  return v.world_from_body.empty()
             ? v.camera_from_world
             : v.camera_from_world * v.world_from_body[static_cast<size_t>(body)];
}

TexturedScene MakeTexturedScene(const TexturedSceneOptions& options) {
  TexturedScene scene;
  scene.bodies.push_back({Floor(BlobTexture(options.seed, options.contrast))});
  scene.bodies.push_back(Boxes(options.boxes, 0.2, options.seed));
  std::mt19937 rng(options.seed + 1000);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  for (int v = 0; v < options.views; ++v) {
    const double share = options.views > 1 ? v / (options.views - 1.0) - 0.5 : 0.0;
    TexturedView view;
    const double zoom = v % 2 == 0 ? 1.0 : options.zoom;
    view.camera =
        CenteredCamera(options.width, options.height, zoom * options.focal_widths * options.width);
    // Heights and distances differ as of a hand, in proportion to the arc.
    const double hand = std::min(options.arc_rad, 1.0);
    view.camera_from_world = Looking(OnArc(share * options.arc_rad,
                                           0.75 + 0.15 * hand * u(rng),
                                           options.distance_m * (1.0 + 0.1 * hand * u(rng))),
                                     {0.02 * hand * u(rng), 0.02 * hand * u(rng), 0.03});
    scene.views.push_back(view);
  }
  return scene;
}

cv::Mat RenderTextured(const TexturedScene& scene, int view, double noise) {
  const TexturedView& v = scene.views[static_cast<size_t>(view)];
  const std::vector<Facet> facets = FacetsOf(scene, view);
  cv::Mat grey(v.camera.height, v.camera.width, CV_32F);
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) {
      double sum = 0.0;
      for (const Vector2d& offset : {Vector2d(-0.25, -0.25),
                                     Vector2d(0.25, -0.25),
                                     Vector2d(-0.25, 0.25),
                                     Vector2d(0.25, 0.25)}) {
        const Vector2d pixel = Vector2d(x, y) + offset;
        const Rigid3 world_from_camera = AtRow(v, pixel.y()).Inverse();
        sum += Radiance(facets,
                        scene.background,
                        world_from_camera.t,
                        world_from_camera.R * NormalizedPoint(v.camera, pixel).homogeneous());
      }
      grey.at<float>(y, x) = static_cast<float>(0.25 * sum);
    }
  }
  cv::Mat grain(grey.size(), CV_32F), levels, out;
  cv::RNG rng(static_cast<uint64>(view) + 4242);
  rng.fill(grain, cv::RNG::NORMAL, 0.0, noise);
  cv::Mat(grey + grain).convertTo(levels, CV_8U);
  if (v.mirrored) cv::flip(levels, levels, 1);
  cv::cvtColor(levels, out, cv::COLOR_GRAY2BGR);
  return out;
}

std::vector<cv::Mat> RenderTextured(const TexturedScene& scene, double noise) {
  std::vector<cv::Mat> images;
  for (size_t v = 0; v < scene.views.size(); ++v) {
    images.push_back(RenderTextured(scene, static_cast<int>(v), noise));
  }
  return images;
}

TexturedScene WithoutOverlap(unsigned seed, int views) {
  TexturedScene scene;
  scene.bodies.resize(1);
  for (int v = 0; v < views; ++v) {
    const Vector3d there(3.0 * v, 0.0, 0.0);
    TexturedRectangle floor = Floor(BlobTexture(seed + 100U * static_cast<unsigned>(v)));
    floor.corner += there;
    scene.bodies[0].push_back(floor);
    for (TexturedRectangle face : Boxes(3, 0.2, seed + 50 + static_cast<unsigned>(v))) {
      face.corner += there;
      scene.bodies[0].push_back(face);
    }
    TexturedView view;
    view.camera = CenteredCamera(640, 480, 1.3 * 640);
    view.camera_from_world =
        Looking(there + OnArc(0.2 * v, 0.75, 0.8), there + Vector3d(0.0, 0.0, 0.03));
    scene.views.push_back(view);
  }
  return scene;
}

TexturedScene OnTurntable(unsigned seed, int views) {
  TexturedScene scene = FromStandingCamera(views);
  TexturedBody disc = Boxes(3, 0.12, seed);
  TexturedRectangle top = Floor(BlobTexture(seed + 1), 0.4);
  top.corner.z() = 0.002;
  disc.push_back(top);
  scene.bodies = {{Floor(BlobTexture(seed + 2)), Wall(seed + 3)}, disc};
  for (int v = 0; v < views; ++v) {
    scene.views[static_cast<size_t>(v)].world_from_body[1].R =
        Eigen::AngleAxisd(0.25 * v, Vector3d::UnitZ()).toRotationMatrix();
  }
  return scene;
}

TexturedScene OnConveyor(unsigned seed, int views) {
  TexturedScene scene = FromStandingCamera(views);
  TexturedBody belt = Boxes(4, 0.15, seed);
  TexturedRectangle top =
      Rectangle({-1.0, -0.25, 0.002}, {2.0, 0.0, 0.0}, {0.0, 0.5, 0.0}, BlobTexture(seed + 1));
  belt.push_back(top);
  scene.bodies = {{Floor(BlobTexture(seed + 2)), Wall(seed + 3)}, belt};
  for (int v = 0; v < views; ++v) {
    const double share = views > 1 ? v / (views - 1.0) - 0.5 : 0.0;
    scene.views[static_cast<size_t>(v)].world_from_body[1].t.x() = 0.3 * share;
  }
  return scene;
}

TexturedScene TurnedOnly(unsigned seed, int views) {
  TexturedSceneOptions options;
  options.seed = seed;
  options.views = views;
  TexturedScene scene = MakeTexturedScene(options);
  const Vector3d eye = scene.views[0].camera_from_world.Inverse().t;
  for (int v = 0; v < views; ++v) {
    const double share = views > 1 ? v / (views - 1.0) - 0.5 : 0.0;
    scene.views[static_cast<size_t>(v)].camera_from_world =
        Looking(eye, {0.25 * share, 0.12 * std::sin(5.0 * share), 0.03});
  }
  return scene;
}

TexturedScene OnRepeats(unsigned seed, int views, const cv::Mat& texture, double texel_m) {
  TexturedSceneOptions options;
  options.seed = seed;
  options.views = views;
  options.boxes = 3;
  TexturedScene scene = MakeTexturedScene(options);
  scene.bodies[0][0].texture = texture;
  scene.bodies[0][0].texel_m = texel_m;
  for (size_t k = 0; k < scene.bodies[1].size(); ++k) {
    scene.bodies[1][k].texture =
        cv::Mat(8, 8, CV_32F, cv::Scalar(90.0 + 25.0 * static_cast<double>(k % 5)));
  }
  return scene;
}

TexturedScene WithScreenAndMirror(unsigned seed, int views) {
  TexturedSceneOptions options;
  options.seed = seed;
  options.views = views;
  options.boxes = 2;
  TexturedScene scene = MakeTexturedScene(options);
  scene.bodies[0][0].texture = cv::Mat(8, 8, CV_32F, cv::Scalar(150));
  TexturedRectangle screen = Rectangle({-0.3, 0.25, 0.0}, {0.35, 0.0, 0.0}, {0.0, 0.1, 0.25}, {});
  for (int v = 0; v < views; ++v) {
    screen.screen.push_back(BlobTexture(seed + 300 + static_cast<unsigned>(v)));
  }
  TexturedRectangle mirror = Rectangle({0.08, 0.25, 0.0}, {0.3, 0.0, 0.0}, {0.0, 0.05, 0.25}, {});
  mirror.mirrors = true;
  scene.bodies[0].push_back(screen);
  scene.bodies[0].push_back(mirror);
  return scene;
}

}  // namespace horopter
