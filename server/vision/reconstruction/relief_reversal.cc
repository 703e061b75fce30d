#include "server/vision/reconstruction/relief_reversal.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <optional>

#include "server/vision/reconstruction/scene_frame.h"

namespace horopter {

CalibratedScene TurnedInsideOut(const CalibratedScene& scene) {
  CalibratedScene out = scene;
  const auto first = std::find_if(
      scene.views.begin(), scene.views.end(), [](const auto& v) { return v.has_value(); });
  if (first == scene.views.end()) return out;
  const Eigen::Matrix3d frame = (*first)->camera_from_scene.R;
  const Eigen::Matrix3d mirror =
      frame.transpose() * Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal() * frame;
  const Eigen::Matrix3d flip = Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal();
  const Eigen::Vector3d middle = FacingTheCameras(scene).centre;
  for (auto& X : out.points) {
    if (X) *X = middle + mirror * (*X - middle);
  }
  for (auto& view : out.views) {
    if (!view) continue;
    const Eigen::Vector3d seen = view->camera_from_scene * middle;
    view->camera_from_scene.R = flip * view->camera_from_scene.R * mirror;
    view->camera_from_scene.t = seen - view->camera_from_scene.R * middle;
  }
  return out;
}

double LargestTurn(OptionalViews a, OptionalViews b) {
  double largest = 0.0;
  std::optional<size_t> first;
  for (size_t v = 0; v < std::min(a.size(), b.size()); ++v) {
    if (!a[v] || !b[v]) continue;
    if (!first) first = v;
    const Eigen::Matrix3d in_a =
        a[v]->camera_from_scene.R * a[*first]->camera_from_scene.R.transpose();
    const Eigen::Matrix3d in_b =
        b[v]->camera_from_scene.R * b[*first]->camera_from_scene.R.transpose();
    largest = std::max(largest, Eigen::AngleAxisd(in_a.transpose() * in_b).angle());
  }
  return largest;
}

}  // namespace horopter
