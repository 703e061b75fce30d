#include "server/vision/euclidean/supporting_plane_search.h"

#include <algorithm>

namespace horopter {
namespace {

constexpr double kTouchM = 0.003;  // an object this near to the plane stands on it
constexpr double kBelow = 0.1;     // of an object's diameter below the plane: it is another plane

double LowestAlong(const AdjustedObject& o, const Eigen::Vector3d& normal) {
  double lowest = 1e9;
  const Eigen::Vector3d n = o.scene_from_object.R.transpose() * normal;
  for (const auto& v : o.model->model.mesh.vertices) lowest = std::min(lowest, n.dot(v));
  return lowest + normal.dot(o.scene_from_object.t);
}

}  // namespace

std::optional<SupportingPlane> FindSupportingPlane(const SceneBundle& bundle) {
  if (!bundle.plane.cells.empty()) {
    // plane.(X - anchor) = -1; the anchor, a mean camera, lies on its positive side.
    const double norm = bundle.plane.plane.norm();
    SupportingPlane plane{bundle.plane.plane / norm,
                          (bundle.plane.plane.dot(bundle.plane.anchor) - 1.0) / norm};
    bool above = true;
    double lowest = plane.offset_m;
    for (const AdjustedObject& o : bundle.objects) {
      const double at = LowestAlong(o, plane.normal);
      above = above && at > plane.offset_m - kBelow * o.model->model.diameter_m;
      lowest = std::min(lowest, at);
    }
    plane.offset_m = lowest;
    if (above) return plane;
  }
  std::optional<SupportingPlane> best;
  int most = 0;
  double best_margin = -1.0;
  for (const AdjustedObject& o : bundle.objects) {
    for (const StablePose& stable : o.model->stable_poses) {
      const Eigen::Vector3d normal = o.scene_from_object.R * stable.up;
      const double offset = normal.dot(o.scene_from_object.t) - stable.height_m;
      int standing = 0;
      double lowest = offset;
      bool free = true;
      for (const AdjustedObject& other : bundle.objects) {
        const double at = LowestAlong(other, normal);
        free = free && at > offset - kTouchM;
        standing += at < offset + kTouchM;
        lowest = std::min(lowest, at);
      }
      for (const AdjustedView& view : bundle.views) {
        if (view.known) free = free && normal.dot(view.camera_from_scene.Inverse().t) > offset;
      }
      if (!free || standing < most || (standing == most && stable.margin_m <= best_margin))
        continue;
      most = standing;
      best_margin = stable.margin_m;
      best = SupportingPlane{normal, lowest};
    }
  }
  return best;
}

}  // namespace horopter
