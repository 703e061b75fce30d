#include "server/pipeline/deciding_view.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <vector>

namespace horopter {
namespace {

constexpr double kLeastElevation = 0.25;  // sine, of a camera above the plane: 15 degrees
constexpr double kLeastPx = 4.0;          // of differing edge: less decides nothing

// What is up: the plane's normal, else the mean of the cameras' own.
Eigen::Vector3d UpOf(const MetricScene& scene) {
  if (scene.plane) return scene.plane->normal;
  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  for (const auto& camera : scene.cameras) {
    if (camera) up -= camera->camera_from_scene.R.row(1).transpose();
  }
  return up;
}

Rigid3 LookingAt(const Eigen::Vector3d& from,
                 const Eigen::Vector3d& at,
                 const Eigen::Vector3d& up) {
  const Eigen::Vector3d forward = (at - from).normalized();
  Eigen::Vector3d right = forward.cross(up);
  if (right.norm() < 1e-3 * up.norm() || up.isZero()) right = forward.unitOrthogonal();
  right.normalize();
  Rigid3 scene_from_camera;
  scene_from_camera.R.col(0) = right;
  scene_from_camera.R.col(1) = forward.cross(right);
  scene_from_camera.R.col(2) = forward;
  scene_from_camera.t = from;
  return scene_from_camera;
}

}  // namespace

std::optional<DecidingView> FindDecidingView(std::span<const ViewDifference> views,
                                             const Rigid3& scene_from_object,
                                             const Eigen::Vector3d& object_middle,
                                             const MetricScene& scene) {
  const Eigen::Vector3d middle = scene_from_object * object_middle;
  std::vector<double> distances;
  for (const auto& camera : scene.cameras) {
    if (camera) distances.push_back((camera->camera_from_scene * middle).norm());
  }
  if (distances.empty()) return std::nullopt;
  const auto half = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
  std::nth_element(distances.begin(), half, distances.end());
  const ViewDifference* best = nullptr;
  for (const ViewDifference& v : views) {
    if (scene.plane &&
        (scene_from_object.R * v.toward_camera).dot(scene.plane->normal) < kLeastElevation)
      continue;
    if (v.differing_px >= kLeastPx && (best == nullptr || v.differing_px > best->differing_px))
      best = &v;
  }
  if (best == nullptr) return std::nullopt;
  const Eigen::Vector3d from = middle + *half * (scene_from_object.R * best->toward_camera);
  return DecidingView{LookingAt(from, middle, UpOf(scene)), best->differing_px};
}

}  // namespace horopter
