#include "server/vision/geometry/image_regions.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace horopter {
namespace {

constexpr double kDeviations = 2.0;  // standard deviations by which a box is grown; chosen
// Of the distance to the box's farthest corner: nearer to the camera's plane nothing has an image.
constexpr double kNearShare = 1e-3;
constexpr int kSteps = 16;  // of an edge, which a lens bends

// Where the lens is believed: beyond, with k1 < 0, it folds back.
Eigen::Vector2d Unfolded(double k1, const Eigen::Vector2d& ray) {
  if (k1 >= 0.0) return ray;
  const double reach = std::sqrt(-1.0 / (3.0 * k1)), r = ray.norm();
  return r > reach ? Eigen::Vector2d(ray * (reach / r)) : ray;
}

// The image of a point in front of the camera, as large as it may be displaced.
ImageBox PointBox(const PinholeCamera& camera,
                  const Eigen::Vector3d& point,
                  const CameraDeviation& deviation) {
  const Eigen::Vector2d ray = Unfolded(camera.k1, point.head<2>() / point.z());
  const Eigen::Vector2d at = Project(camera, {ray.x(), ray.y(), 1.0});
  const double turned = deviation.turn_rad * (1.0 + ray.squaredNorm());
  const double shifted = deviation.shift_m / point.z() * (1.0 + ray.norm());
  const double zoomed = deviation.log_focal * ray.norm();
  const Eigen::Vector2d margin =
      Eigen::Vector2d::Constant(kDeviations * camera.focal_px * (turned + shifted + zoomed));
  return {at - margin, at + margin};
}

}  // namespace

ImageBox WholeImage(int width, int height) {
  return {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(width - 0.5, height - 0.5)};
}

std::optional<ImageBox> BoxInImage(const SpaceBox& box,
                                   const CalibratedCamera& view,
                                   const CameraDeviation& deviation) {
  const Rigid3 camera_from_box = view.camera_from_scene * box.base_from_box;
  std::array<Eigen::Vector3d, 8> corners;
  double farthest = 0.0;
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d side(i & 1 ? 0.5 : -0.5, i & 2 ? 0.5 : -0.5, i & 4 ? 0.5 : -0.5);
    corners[i] = camera_from_box * Eigen::Vector3d(side.cwiseProduct(box.size_m));
    farthest = std::max(farthest, corners[i].norm());
  }
  const double near = kNearShare * farthest;
  ImageBox found;
  for (int i = 0; i < 8; ++i) {
    for (const int axis : {1, 2, 4}) {
      if (i & axis) continue;
      Eigen::Vector3d a = corners[i], b = corners[i | axis];
      if (a.z() > b.z()) std::swap(a, b);
      if (!(b.z() > near)) continue;
      if (a.z() < near) a = b + (a - b) * ((b.z() - near) / (b.z() - a.z()));
      for (int k = 0; k <= kSteps; ++k)
        found.extend(PointBox(view.camera, a + (b - a) * (1.0 * k / kSteps), deviation));
    }
  }
  found = found.intersection(WholeImage(view.camera.width, view.camera.height));
  if (found.isEmpty() || !(found.sizes().minCoeff() > 0.0)) return std::nullopt;
  return found;
}

double ShareInBoxes(const ImageBox& box, std::span<const ImageBox> others) {
  if (box.isEmpty() || !(box.volume() > 0.0)) return 0.0;
  double inside = 0.0;
  for (const ImageBox& other : others) {
    const ImageBox both = box.intersection(other);
    if (!both.isEmpty()) inside += both.volume();
  }
  return std::min(1.0, inside / box.volume());
}

bool InBoxes(const Eigen::Vector2d& point, std::span<const ImageBox> boxes) {
  return std::any_of(
      boxes.begin(), boxes.end(), [&](const ImageBox& box) { return box.contains(point); });
}

}  // namespace horopter
