#include "server/vision/recognition/scene/surface_texture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "server/base/parallel_for.h"
#include "server/vision/features/image_strips.h"
#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/recognition/learnt_constants.h"

namespace horopter {

struct SurfaceImages {
  std::vector<cv::Mat> grey;  // CV_32F
};

namespace {

constexpr double kEdgeMargin = 1.8;     // half windows between a patch and the next edge
constexpr double kMinFacing = 0.3;      // cosine between a face's normal and the view
constexpr double kWindowWidth = 640.0;  // image width that window and shift are stated for
constexpr double kMostWidth = 1280.0;   // wider images are made smaller
constexpr double kSmoothing = 1.0;      // pixels of such an image
constexpr double kPlaneShare = 0.7;     // of the shift: nearer transfers are not told apart

struct Patch {
  Eigen::Vector3d point;  // scene frame
  Eigen::Vector3d normal;
  double edge_distance_m = 0.0;  // to the nearest edge of the object
};

struct SurfaceView {
  cv::Mat grey;  // CV_32F, at most kMostWidth wide
  PinholeCamera camera;
  Rigid3 camera_from_scene;
  Eigen::Vector3d center;  // of the camera, in the scene
  DepthBuffer depth;       // of all objects, drawn without k1
  double scale = 1.0;      // pixels per pixel of a 640 wide image
};

double EdgeDistance(const PreparedObject& object, const Eigen::Vector3d& point) {
  const Eigen::Vector3f p = point.cast<float>();
  float nearest = std::numeric_limits<float>::max();
  for (const EdgeSample& s : object.samples)
    nearest = std::min(nearest, (s.point - p).squaredNorm());
  return std::sqrt(nearest);
}

std::vector<Patch> Patches(const PreparedObject& object,
                           const Rigid3& scene_from_object,
                           double spacing) {
  std::vector<Patch> patches;
  const TriangleMesh& mesh = object.model.mesh;
  double carry = 0.5;  // so that many small triangles get their share
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]], ab = mesh.vertices[t[1]] - a,
                          ac = mesh.vertices[t[2]] - a, cross = ab.cross(ac);
    const double area = 0.5 * cross.norm();
    if (!(area > 0)) continue;
    carry += area / (spacing * spacing);
    const int count = static_cast<int>(carry);
    carry -= count;
    // A low-discrepancy sequence (R2) folded into the triangle.
    for (int i = 0; i < count; ++i) {
      double u = std::fmod(0.5 + 0.7548776662466927 * (i + 1), 1.0);
      double v = std::fmod(0.5 + 0.5698402909980532 * (i + 1), 1.0);
      if (u + v > 1.0) u = 1.0 - u, v = 1.0 - v;
      const Eigen::Vector3d point = a + u * ab + v * ac;
      patches.push_back({scene_from_object * point,
                         scene_from_object.R * (cross / (2.0 * area)),
                         EdgeDistance(object, point)});
    }
  }
  return patches;
}

std::vector<SurfaceView> SurfaceViews(const JointContext& context,
                                      const SurfaceImages& images,
                                      const SceneModel& scene) {
  std::vector<SurfaceView> views;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    SurfaceView view;
    view.grey = images.grey[v];
    const double size = static_cast<double>(view.grey.cols) / scene.views[v]->camera.width;
    view.scale = view.grey.cols / kWindowWidth;
    const PinholeCamera& camera = scene.views[v]->camera;
    view.camera = {view.grey.cols,
                   view.grey.rows,
                   camera.focal_px * size,
                   (camera.cx + 0.5) * size - 0.5,
                   (camera.cy + 0.5) * size - 0.5,
                   camera.k1};
    view.camera_from_scene = scene.views[v]->camera_from_scene;
    view.center = view.camera_from_scene.Inverse().t;
    view.depth = MakeDepthBuffer(view.grey.cols, view.grey.rows);
    for (const PlacedObject& o : scene.objects) {
      RenderDepth(context.objects[o.object]->model.mesh,
                  view.camera,
                  view.camera_from_scene * o.scene_from_object,
                  &view.depth);
    }
    views.push_back(std::move(view));
  }
  return views;
}

// Pixel of a point (camera frame, z > 0) in the depth buffer.
Eigen::Vector2d DepthPixel(const SurfaceView& view, const Eigen::Vector3d& p) {
  PinholeCamera straight = view.camera;
  straight.k1 = 0.0;
  return Project(straight, p);
}

bool Sees(const SurfaceView& view, const Patch& patch, double tolerance_m) {
  const Eigen::Vector3d to_camera = (view.center - patch.point).normalized();
  if (to_camera.dot(patch.normal) < kMinFacing) return false;
  const Eigen::Vector3d p = view.camera_from_scene * patch.point;
  return p.z() > 0 && IsVisible(view.depth, DepthPixel(view, p), p.z(), tolerance_m);
}

// Grey values at the pixels of a square window, row by row, without their linear trend: shading
// has one, and it differs from view to view. Empty where the window leaves the image.
std::vector<float> Window(const SurfaceView& view, std::span<const Eigen::Vector2d> pixels) {
  std::vector<float> values;
  values.reserve(pixels.size());
  for (const Eigen::Vector2d& u : pixels) {
    const int x = static_cast<int>(std::floor(u.x())), y = static_cast<int>(std::floor(u.y()));
    if (x < 0 || y < 0 || x + 1 >= view.grey.cols || y + 1 >= view.grey.rows) return {};
    const float fx = static_cast<float>(u.x() - x), fy = static_cast<float>(u.y() - y);
    const float *top = view.grey.ptr<float>(y) + x, *low = view.grey.ptr<float>(y + 1) + x;
    values.push_back((1 - fy) * ((1 - fx) * top[0] + fx * top[1]) +
                     fy * ((1 - fx) * low[0] + fx * low[1]));
  }
  const int side = static_cast<int>(std::lround(std::sqrt(values.size())));
  const float middle = 0.5f * static_cast<float>(side - 1);
  float mean = 0.0f, along_x = 0.0f, along_y = 0.0f, squares = 0.0f;
  const auto at = [&](std::size_t i) {
    return std::pair(static_cast<float>(i % side) - middle, static_cast<float>(i / side) - middle);
  };
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto [x, y] = at(i);
    mean += values[i];
    along_x += x * values[i];
    along_y += y * values[i];
    squares += x * x;
  }
  mean /= static_cast<float>(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto [x, y] = at(i);
    values[i] -= mean + (x * along_x + y * along_y) / squares;
  }
  return values;
}

double Deviation(const std::vector<float>& window) {
  double squares = 0.0;
  for (const float v : window) squares += static_cast<double>(v) * v;
  return window.empty() ? 0.0 : std::sqrt(squares / static_cast<double>(window.size()));
}

// Normalised correlation of two windows; -1 where one is missing or flat.
double Correlation(const std::vector<float>& a, const std::vector<float>& b) {
  const double da = Deviation(a), db = Deviation(b);
  if (a.size() != b.size() || !(da > 0.5) || !(db > 0.5)) return -1.0;
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += static_cast<double>(a[i]) * b[i];
  return sum / (static_cast<double>(a.size()) * da * db);
}

// Where the plane through `point` takes the pixels of one view in another; empty when it does not.
std::vector<Eigen::Vector2d> Transfer(const SurfaceView& from,
                                      std::span<const Eigen::Vector2d> pixels,
                                      const Eigen::Vector3d& point,
                                      const Eigen::Vector3d& normal,
                                      const SurfaceView& to) {
  const Eigen::Matrix3d scene_from_camera = from.camera_from_scene.R.transpose();
  const double distance = normal.dot(point - from.center);
  std::vector<Eigen::Vector2d> out;
  out.reserve(pixels.size());
  for (const Eigen::Vector2d& u : pixels) {
    const Eigen::Vector3d ray = scene_from_camera * NormalizedPoint(from.camera, u).homogeneous();
    const double along = distance / normal.dot(ray);
    if (!(along > 0) || !std::isfinite(along)) return {};
    const Eigen::Vector3d p = to.camera_from_scene * (from.center + along * ray);
    if (p.z() <= 0) return {};
    out.push_back(Project(to.camera, p));
  }
  return out;
}

class Comparison {
 public:
  Comparison(const SceneModel& scene,
             const std::vector<SurfaceView>& views,
             double diameter_m,
             const SurfaceTextureOptions& options)
      : scene_(scene), views_(views), diameter_m_(diameter_m), options_(options) {}

  // More than 0: alike in most of the views; less: unlike; 0: nothing is said.
  int Judge(const Patch& patch) const {
    const double tolerance = kHiddenShareOfFaces * diameter_m_;
    int best = -1;
    double best_size = 0.0;
    std::vector<int> seeing;
    for (int i = 0; i < static_cast<int>(views_.size()); ++i) {
      if (!Sees(views_[i], patch, tolerance)) continue;
      seeing.push_back(i);
      const Eigen::Vector3d to = views_[i].center - patch.point;
      const double size = to.normalized().dot(patch.normal) * views_[i].camera.focal_px / to.norm();
      if (size > best_size) best_size = size, best = i;
    }
    if (seeing.size() < 2) return 0;
    const SurfaceView& from = views_[best];
    // Edges have had their say.
    if (patch.edge_distance_m * best_size < kEdgeMargin * options_.half_window * from.scale)
      return 0;
    const std::vector<Eigen::Vector2d> pixels = Square(from, patch);
    if (!ShowsWindow(from, from, pixels, patch)) return 0;
    const std::vector<float> values = Window(from, pixels);
    if (Deviation(values) < options_.min_deviation) return 0;
    int votes = 0;
    for (const int i : seeing) {
      if (i != best) votes += Vote(from, pixels, values, patch, views_[i]);
    }
    return votes;
  }

 private:
  std::vector<Eigen::Vector2d> Square(const SurfaceView& view, const Patch& patch) const {
    const Eigen::Vector2d middle = Project(view.camera, view.camera_from_scene * patch.point);
    std::vector<Eigen::Vector2d> pixels;
    const int h = options_.half_window;
    for (int y = -h; y <= h; ++y) {
      for (int x = -h; x <= h; ++x) pixels.push_back(middle + view.scale * Eigen::Vector2d(x, y));
    }
    return pixels;
  }

  // Whether a view shows the patch's plane at the window's corners: no other surface in front, and
  // no end of the face.
  bool ShowsWindow(const SurfaceView& from,
                   const SurfaceView& view,
                   std::span<const Eigen::Vector2d> pixels,
                   const Patch& patch) const {
    const int side = 2 * options_.half_window + 1;
    const double distance = patch.normal.dot(patch.point - from.center);
    for (const int i : {0, side - 1, side * (side - 1), side * side - 1}) {
      const Eigen::Vector3d ray = from.camera_from_scene.R.transpose() *
                                  NormalizedPoint(from.camera, pixels[i]).homogeneous();
      const double along = distance / patch.normal.dot(ray);
      if (!(along > 0) || !std::isfinite(along)) return false;
      const Eigen::Vector3d p = view.camera_from_scene * (from.center + along * ray);
      if (p.z() <= 0) return false;
      const Eigen::Vector2d u = DepthPixel(view, p);
      const int x = static_cast<int>(std::lround(u.x())), y = static_cast<int>(std::lround(u.y()));
      if (x < 0 || y < 0 || x >= view.depth.width || y >= view.depth.height) return false;
      if (std::abs(view.depth.At(x, y) - p.z()) > kHiddenShareOfFaces * diameter_m_) return false;
    }
    return true;
  }

  int Vote(const SurfaceView& from,
           std::span<const Eigen::Vector2d> pixels,
           const std::vector<float>& values,
           const Patch& patch,
           const SurfaceView& to) const {
    if (!ShowsWindow(from, to, pixels, patch)) return 0;
    const double shift_px = options_.shift_px * to.scale;
    const Eigen::Vector3d ray = (patch.point - from.center).normalized();
    const auto in_view = [&](const Eigen::Vector3d& p) -> std::optional<Eigen::Vector2d> {
      const Eigen::Vector3d q = to.camera_from_scene * p;
      if (q.z() <= 0) return std::nullopt;
      return Project(to.camera, q);
    };
    const double step = 0.01 * diameter_m_;
    const auto here = in_view(patch.point), there = in_view(patch.point + step * ray);
    if (!here || !there) return 0;
    const double px_per_metre = (*there - *here).norm() / step;
    if (px_per_metre * options_.max_depth_share * diameter_m_ < shift_px) return 0;
    if (scene_.plane) {
      const double along = (scene_.plane->offset_m - scene_.plane->normal.dot(from.center)) /
                           scene_.plane->normal.dot(ray);
      const auto on_plane = in_view(from.center + along * ray);
      if (on_plane && (*on_plane - *here).norm() < kPlaneShare * shift_px) return 0;
    }
    const double depth = shift_px / px_per_metre;
    const auto correlation = [&](double offset) {
      return Correlation(
          values, Window(to, Transfer(from, pixels, patch.point + offset * ray, patch.normal, to)));
    };
    const double fit = correlation(0.0), off = std::max(correlation(-depth), correlation(depth));
    if (fit > options_.min_correlation && fit > off + options_.shift_loss) return 1;
    if (fit < options_.max_correlation) return -1;
    return 0;
  }

  const SceneModel& scene_;
  const std::vector<SurfaceView>& views_;
  double diameter_m_;
  SurfaceTextureOptions options_;
};

}  // namespace

std::shared_ptr<const SurfaceImages> MakeSurfaceImages(std::span<const cv::Mat> images,
                                                       int threads) {
  auto out = std::make_shared<SurfaceImages>();
  out->grey.resize(images.size());
  ParallelFor(static_cast<int>(images.size()), threads, [&](int v) {
    cv::Mat image = images[v];
    const double size = std::min(1.0, kMostWidth / image.cols);
    if (size < 1.0) {
      const int factor = StripFactor(image.size(), size);
      if (factor > 1) image = ShrinkInStrips(image, factor);
      cv::Mat reduced;
      cv::resize(image, reduced, {}, factor * size, factor * size, cv::INTER_AREA);
      image = reduced;
    }
    if (image.channels() == 3) cv::cvtColor(image, image, cv::COLOR_BGR2GRAY);
    cv::Mat& grey = out->grey[v];
    image.convertTo(grey, CV_32F);
    // Noise is no texture.
    cv::GaussianBlur(grey, grey, {}, kSmoothing * grey.cols / kWindowWidth);
  });
  return out;
}

std::vector<SurfaceTexture> CompareSurfaces(const JointContext& context,
                                            const SurfaceImages* images,
                                            const SceneModel& scene,
                                            std::span<const int> objects) {
  std::vector<SurfaceTexture> out(objects.size());
  if (images == nullptr || images->grey.size() != scene.views.size()) return out;
  const SurfaceTextureOptions& options = context.options.search.texture;
  const std::vector<SurfaceView> views = SurfaceViews(context, *images, scene);
  ParallelFor(static_cast<int>(objects.size()), context.options.threads, [&](int i) {
    const PlacedObject& placed = scene.objects.at(objects[i]);
    const PreparedObject& object = *context.objects[placed.object];
    const double diameter = object.model.diameter_m;
    const Comparison comparison(scene, views, diameter, options);
    for (const Patch& patch :
         Patches(object, placed.scene_from_object, options.spacing * diameter)) {
      const int votes = comparison.Judge(patch);
      out[i].alike += votes > 0;
      out[i].unlike += votes < 0;
    }
  });
  return out;
}

double TextureLogLikelihoodRatio(const SurfaceTexture& texture) {
  return std::clamp((texture.alike - kUnlikePatchWeight * texture.unlike) / kPatchesPerLogOdds,
                    -kMostTextureAgainst,
                    kMostTextureFor);
}

void JudgeTexture(const JointContext& context, const SurfaceImages* images, SceneModel* scene) {
  std::vector<int> all(scene->objects.size());
  std::iota(all.begin(), all.end(), 0);
  const std::vector<SurfaceTexture> found = CompareSurfaces(context, images, *scene, all);
  for (std::size_t i = 0; i < found.size(); ++i)
    scene->objects[i].texture = TextureLogLikelihoodRatio(found[i]);
}

void JudgeTexture(const JointContext& context,
                  const SurfaceImages* images,
                  int object,
                  SceneModel* scene) {
  scene->objects.at(object).texture =
      TextureLogLikelihoodRatio(CompareSurfaces(context, images, *scene, {&object, 1})[0]);
}

}  // namespace horopter
