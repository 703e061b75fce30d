#include "server/vision/recognition/aspect_search/pose_rendering.h"

#include <Eigen/Core>
#include <algorithm>
#include <limits>

#include "server/vision/recognition/aspect_search/near_plane.h"

namespace horopter {
namespace {

constexpr double kCubeShare = 0.29;  // half the side of the cube, of the diameter

Eigen::Vector2d WithoutLens(const PinholeCamera& camera, const Eigen::Vector3d& in_camera) {
  return {camera.focal_px * in_camera.x() / in_camera.z() + camera.cx,
          camera.focal_px * in_camera.y() / in_camera.z() + camera.cy};
}

}  // namespace

double PoseShiftPx(const RenderMesh& mesh,
                   const PinholeCamera& camera_a,
                   const Rigid3& a,
                   const PinholeCamera& camera_b,
                   const Rigid3& b) {
  const Eigen::Vector3d center = mesh.center.cast<double>();
  const double h = kCubeShare * mesh.diameter_m;
  double most = 0.0;
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d corner =
        center + h * Eigen::Vector3d(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
    const Eigen::Vector3d in_a = a * corner, in_b = b * corner;
    if (in_a.z() < kNearM || in_b.z() < kNearM) return std::numeric_limits<double>::infinity();
    most = std::max(most, (WithoutLens(camera_a, in_a) - WithoutLens(camera_b, in_b)).norm());
  }
  return most;
}

PoseRendering::PoseRendering(const RenderMesh& mesh,
                             const VisibleEdgeOptions& options,
                             double stale_px)
    : mesh_(mesh), options_(options), stale_px_(stale_px) {}

const VisibleEdges& PoseRendering::At(const PinholeCamera& camera,
                                      const Rigid3& camera_from_object) {
  if (!has_ || PoseShiftPx(mesh_, rendered_camera_, rendered_pose_, camera, camera_from_object) >
                   stale_px_) {
    edges_ = FindVisibleEdges(mesh_, camera, camera_from_object, options_);
    rendered_camera_ = camera;
    rendered_pose_ = camera_from_object;
    has_ = true;
  } else {
    Move(camera, camera_from_object);
  }
  camera_ = camera;
  pose_ = camera_from_object;
  return edges_;
}

void PoseRendering::Move(const PinholeCamera& camera, const Rigid3& camera_from_object) {
  for (VisibleEdgePoint& p : edges_.points) {
    const Eigen::Vector3d x = camera_from_object * p.point.cast<double>();
    if (x.z() < kNearM) continue;
    const Eigen::Vector3d d = camera_from_object.R * p.direction.cast<double>();
    // Derivative of the image along the edge, up to scale; the lens turns it by less than matters.
    const Eigen::Vector2d tangent(d.x() * x.z() - x.x() * d.z(), d.y() * x.z() - x.y() * d.z());
    p.image = Project(camera, x).cast<float>();
    if (tangent.squaredNorm() > 1e-24) p.tangent = tangent.normalized().cast<float>();
  }
  RenderedView& view = edges_.view;
  if (view.width == 0) return;
  const Eigen::Vector3d before = pose_ * mesh_.center.cast<double>();
  const Eigen::Vector3d after = camera_from_object * mesh_.center.cast<double>();
  const double grown = (camera.focal_px / after.z()) / (camera_.focal_px / before.z());
  view.origin = WithoutLens(camera, after) + grown * (view.origin - WithoutLens(camera_, before));
  view.scale /= grown;
}

}  // namespace horopter
