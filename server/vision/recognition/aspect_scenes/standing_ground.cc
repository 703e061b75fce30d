#include "server/vision/recognition/aspect_scenes/standing_ground.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/aspect_search/aspect_score.h"

namespace horopter {
namespace {

constexpr double kFarShare = 1.8;         // of the parts' depth: no farther is searched
constexpr double kNearM = 1e-3;           // points nearer to the camera plane have no image
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
      const Eigen::Vector2d pixel((i % kRays) * (ground->images[v]->width - 1.0) / (kRays - 1),
                                  (i / kRays) * (ground->images[v]->height - 1.0) / (kRays - 1));
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

// Edge points that no part taken explains: [y][x] holds those above and left of a half map's cell.
std::vector<std::int32_t> SumUnexplained(const AspectImage& image,
                                         const std::vector<ObjectLayer>& layers) {
  const int w = image.half_width + 1;
  std::vector<std::int32_t> sums(static_cast<std::size_t>(w) * (image.half_height + 1), 0);
  for (const ImageEdgePoint& e : image.edges) {
    const int x = static_cast<int>(std::lround(e.point.x()));
    const int y = static_cast<int>(std::lround(e.point.y()));
    const bool explained = std::any_of(layers.begin(), layers.end(), [&](const ObjectLayer& l) {
      return l.Has(x, y) && (l.inverse_depth[l.Cell(x, y)] > 0 ||
                             l.edge_bin[l.Cell(x, y)] != ObjectLayer::kNoEdge);
    });
    const int cx = x / 2, cy = y / 2;
    if (explained || cx < 0 || cy < 0 || cx >= image.half_width || cy >= image.half_height)
      continue;
    ++sums[static_cast<std::size_t>(cy + 1) * w + cx + 1];
  }
  for (int y = 1; y <= image.half_height; ++y) {
    for (int x = 1; x < w; ++x) {
      const std::size_t at = static_cast<std::size_t>(y) * w + x;
      sums[at] += sums[at - 1] + sums[at - w] - sums[at - w - 1];
    }
  }
  return sums;
}

}  // namespace

bool IsShown(const StandingGround& ground, std::size_t v, const Eigen::Vector3d& in_camera) {
  if (in_camera.z() < kNearM) return false;
  const Eigen::Vector2d u = Project(ground.cameras[v], in_camera);
  return u.x() >= 0 && u.y() >= 0 && u.x() < ground.images[v]->width &&
         u.y() < ground.images[v]->height;
}

int UnexplainedNear(const StandingGround& ground,
                    std::size_t v,
                    const Eigen::Vector2d& at,
                    double half_px) {
  const AspectImage& image = *ground.images[v];
  const auto cell = [](double pixel, int size) {
    return std::clamp(static_cast<int>(0.5 * pixel), 0, size);
  };
  const int x0 = cell(at.x() - half_px, image.half_width),
            x1 = cell(at.x() + half_px, image.half_width);
  const int y0 = cell(at.y() - half_px, image.half_height);
  const int y1 = cell(at.y() + half_px, image.half_height);
  const std::size_t w = image.half_width + 1;
  const std::vector<std::int32_t>& sums = ground.unexplained[v];
  return sums[y1 * w + x1] - sums[y0 * w + x1] - sums[y1 * w + x0] + sums[y0 * w + x0];
}

StandingGround MakeGround(std::span<const AspectImage> images,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const StandingPlane& plane,
                          std::span<const AspectSceneObject> taken,
                          std::span<const AspectModel> models) {
  StandingGround out;
  out.plane = plane;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    out.images.push_back(&images[v]);
    out.cameras.push_back(WorkingCamera(images[v], views[v]->camera));
    out.camera_from_scene.push_back(views[v]->camera_from_scene);
    std::vector<ObjectLayer> layers;
    for (const AspectSceneObject& o : taken) {
      layers.push_back(MakeObjectLayer(images[v],
                                       models[o.object].object->mesh,
                                       views[v]->camera,
                                       views[v]->camera_from_scene * o.scene_from_object,
                                       kLayerRenderPx));
    }
    out.unexplained.push_back(SumUnexplained(images[v], layers));
  }
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
