#include "server/vision/recognition/aspect_scenes/standing_ground.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspect_search/near_plane.h"
#include "server/vision/recognition/aspect_search/object_layers.h"
#include "server/vision/recognition/aspects/aspect_maps.h"

namespace horopter {
namespace {

constexpr double kFarShare = 1.8;         // of the parts' depth: no farther is searched
constexpr double kLayerRenderPx = 110.0;  // of a part that hides others; chosen

std::size_t Showing(const StandingGround& ground, const Eigen::Vector3d& x) {
  std::size_t shown = 0;
  for (std::size_t v = 0; v < ground.images.size(); ++v)
    shown += IsShown(ground, v, ground.camera_from_scene[v] * x);
  return shown;
}

// Where enough views see the plane, not much farther than the parts.
void FindRegion(StandingGround* ground) {
  for (std::size_t v = 0; v < ground->images.size(); ++v) {
    const Rigid3 scene_from_camera = ground->camera_from_scene[v].Inverse();
    const double far = kFarShare * (ground->camera_from_scene[v] * ground->origin).z();
    constexpr int kRays = 9;  // a side of each image; chosen
    for (int i = 0; i < kRays * kRays; ++i) {
      const Eigen::Vector2d pixel((i % kRays) * (ground->images[v].width - 1.0) / (kRays - 1),
                                  (i / kRays) * (ground->images[v].height - 1.0) / (kRays - 1));
      const Eigen::Vector3d ray =
          scene_from_camera.R * NormalizedPoint(ground->cameras[v], pixel).homogeneous();
      const double falls = -ground->plane.normal.dot(ray);
      const double above = ground->plane.normal.dot(scene_from_camera.t) - ground->plane.offset_m;
      if (falls * far < above || above <= 0) continue;
      const Eigen::Vector3d x = scene_from_camera.t + above / falls * ray;
      if (Showing(*ground, x) < ground->least_views) continue;
      const Eigen::Vector2d at((x - ground->origin).dot(ground->e1),
                               (x - ground->origin).dot(ground->e2));
      ground->low = ground->low.cwiseMin(at);
      ground->high = ground->high.cwiseMax(at);
    }
  }
}

// Which edge points lie on a like-directed edge of one of the parts.
std::vector<bool> ExplainedPlaces(const AspectImage& image,
                                  const std::vector<ObjectLayer>& layers) {
  std::vector<const ObjectLayer*> parts;
  for (const ObjectLayer& layer : layers) parts.push_back(&layer);
  std::vector<bool> out;
  out.reserve(image.edges.size());
  for (const ImageEdgePoint& e : image.edges) {
    out.push_back(IsEdgeOf(parts,
                           static_cast<int>(std::lround(e.point.x())),
                           static_cast<int>(std::lround(e.point.y())),
                           AspectBin(-e.normal.y(), e.normal.x())));
  }
  return out;
}

// [y][x] holds the sum of the cells above and left of a half map's.
std::vector<std::int32_t> Sums(const std::vector<std::uint8_t>& cells, int width, int height) {
  const int w = width + 1;
  std::vector<std::int32_t> sums(static_cast<std::size_t>(w) * (height + 1), 0);
  for (int y = 1; y <= height; ++y) {
    std::int32_t row = 0;
    for (int x = 1; x < w; ++x) {
      row += cells[static_cast<std::size_t>(y - 1) * width + x - 1];
      sums[static_cast<std::size_t>(y) * w + x] =
          sums[static_cast<std::size_t>(y - 1) * w + x] + row;
    }
  }
  return sums;
}

std::vector<std::int32_t> SumEdges(const AspectImage& image) {
  std::vector<std::uint8_t> count(static_cast<std::size_t>(image.half_width) * image.half_height);
  for (const ImageEdgePoint& e : image.edges) {
    const int x =
        std::clamp(static_cast<int>(std::lround(e.point.x())) / 2, 0, image.half_width - 1);
    const int y =
        std::clamp(static_cast<int>(std::lround(e.point.y())) / 2, 0, image.half_height - 1);
    ++count[static_cast<std::size_t>(y) * image.half_width + x];
  }
  return Sums(count, image.half_width, image.half_height);
}

HidingMap MakeHiding(const AspectImage& image, const std::vector<ObjectLayer>& layers) {
  HidingMap out;
  out.width = image.half_width;
  out.height = image.half_height;
  const std::size_t cells = static_cast<std::size_t>(out.width) * out.height;
  out.depth_m.assign(cells, std::numeric_limits<float>::infinity());
  std::vector<std::uint8_t> covered(cells, 0);
  for (const ObjectLayer& l : layers) {
    for (int y = (l.y0 + 1) / 2 * 2; y < l.y0 + l.height; y += 2) {
      for (int x = (l.x0 + 1) / 2 * 2; x < l.x0 + l.width; x += 2) {
        const float near = l.inverse_depth[l.Cell(x, y)];
        if (near <= 0) continue;
        const std::size_t cell = static_cast<std::size_t>(y / 2) * out.width + x / 2;
        out.depth_m[cell] = std::min(out.depth_m[cell], 1.0f / near);
        covered[cell] = 1;
      }
    }
  }
  out.covered = Sums(covered, out.width, out.height);
  return out;
}

// Of sums over the half maps, those in a square about a pixel of the working image; cells: how many
// it has.
int SumNear(const std::vector<std::int32_t>& sums,
            const AspectImage& image,
            const Eigen::Vector2d& at,
            double half_px,
            int* cells = nullptr) {
  const auto cell = [](double pixel, int size) {
    return std::clamp(static_cast<int>(0.5 * pixel), 0, size);
  };
  const int x0 = cell(at.x() - half_px, image.half_width),
            x1 = cell(at.x() + half_px, image.half_width);
  const int y0 = cell(at.y() - half_px, image.half_height);
  const int y1 = cell(at.y() + half_px, image.half_height);
  const std::size_t w = image.half_width + 1;
  if (cells != nullptr) *cells = (x1 - x0) * (y1 - y0);
  return sums[y1 * w + x1] - sums[y0 * w + x1] - sums[y1 * w + x0] + sums[y0 * w + x0];
}

}  // namespace

bool IsShown(const StandingGround& ground, std::size_t v, const Eigen::Vector3d& in_camera) {
  if (in_camera.z() < kNearM) return false;
  const Eigen::Vector2d u = Project(ground.cameras[v], in_camera);
  return u.x() >= 0 && u.y() >= 0 && u.x() < ground.images[v].width &&
         u.y() < ground.images[v].height;
}

int UnexplainedNear(const StandingGround& ground,
                    std::size_t v,
                    const Eigen::Vector2d& at,
                    double half_px) {
  return SumNear(ground.unexplained[v], ground.images[v], at, half_px);
}

double GroundShareNear(const StandingGround& ground,
                       std::size_t v,
                       const Eigen::Vector2d& at,
                       double half_px) {
  if (ground.ground[v].empty()) return 0.0;
  int cells = 0;
  const int sum = SumNear(ground.ground[v], ground.images[v], at, half_px, &cells);
  return cells > 0 ? static_cast<double>(sum) / cells : 0.0;
}

bool IsCoveredNear(const StandingGround& ground,
                   std::size_t v,
                   const Eigen::Vector2d& at,
                   double half_px) {
  return SumNear(ground.hiding[v].covered, ground.images[v], at, half_px) > 0;
}

StandingGround MakeGround(std::span<const AspectImage> images,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const StandingPlane& plane,
                          std::span<const AspectSceneObject> taken,
                          std::span<const AspectModel> models,
                          int threads) {
  StandingGround out;
  out.plane = plane;
  std::vector<std::size_t> seeing;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    seeing.push_back(v);
    out.cameras.push_back(WorkingCamera(images[v], views[v]->camera));
    out.camera_from_scene.push_back(views[v]->camera_from_scene);
  }
  out.images.resize(seeing.size());
  out.unexplained.resize(seeing.size());
  out.hiding.resize(seeing.size());
  out.ground.resize(seeing.size());
  ParallelFor(static_cast<int>(seeing.size()), threads, [&](int i) {
    const std::size_t v = seeing[i];
    std::vector<ObjectLayer> layers;
    for (const AspectSceneObject& o : taken) {
      layers.push_back(MakeObjectLayer(images[v],
                                       models[o.object].object->mesh,
                                       views[v]->camera,
                                       views[v]->camera_from_scene * o.scene_from_object,
                                       kLayerRenderPx));
    }
    out.images[i] = WithoutEdges(images[v], ExplainedPlaces(images[v], layers));
    out.unexplained[i] = SumEdges(out.images[i]);
    out.hiding[i] = MakeHiding(out.images[i], layers);
    const AspectImage& image = out.images[i];
    if (!image.ground.empty())
      out.ground[i] = Sums(image.ground, image.half_width, image.half_height);
  });
  out.least_views = std::max<std::size_t>(2, (out.images.size() + 1) / 2);
  out.origin.setZero();
  for (const AspectSceneObject& o : taken)
    out.origin += o.scene_from_object * models[o.object].object->mesh.center.cast<double>();
  out.origin /= std::max<double>(1.0, static_cast<double>(taken.size()));
  out.origin -= (plane.normal.dot(out.origin) - plane.offset_m) * plane.normal;
  out.e1 = plane.normal.unitOrthogonal();
  out.e2 = plane.normal.cross(out.e1);
  FindRegion(&out);
  return out;
}

}  // namespace horopter
