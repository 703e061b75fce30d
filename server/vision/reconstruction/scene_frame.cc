#include "server/vision/reconstruction/scene_frame.h"

#include <Eigen/Geometry>
#include <algorithm>

namespace horopter {

SimilarityTransform FacingTheCameras(const CalibratedScene& scene) {
  SimilarityTransform out;
  int points = 0, views = 0;
  for (const auto& X : scene.points) {
    if (!X) continue;
    out.centre += *X;
    ++points;
  }
  out.centre /= std::max(1, points);
  Eigen::Vector3d towards = Eigen::Vector3d::Zero();
  double distance = 0.0;
  for (const auto& view : scene.views) {
    if (!view) continue;
    const Eigen::Vector3d d = view->camera_from_scene.Inverse().t - out.centre;
    towards += d.normalized();
    distance += d.norm();
    ++views;
  }
  out.scale = views / std::max(distance, 1e-12);
  out.R = Eigen::Quaterniond::FromTwoVectors(towards, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return out;
}

SimilarityTransform OnPlane(const CalibratedScene& scene,
                            const Eigen::Vector3d& normal,
                            double offset) {
  SimilarityTransform out = FacingTheCameras(scene);
  out.centre += (offset - normal.dot(out.centre)) * normal;
  out.R = Eigen::Quaterniond::FromTwoVectors(normal, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return out;
}

CalibratedView Moved(const CalibratedView& view, const SimilarityTransform& world_from_scene) {
  CalibratedView moved = view;
  const Eigen::Vector3d centre = world_from_scene * view.camera_from_scene.Inverse().t;
  moved.camera_from_scene.R = view.camera_from_scene.R * world_from_scene.R.transpose();
  moved.camera_from_scene.t = -(moved.camera_from_scene.R * centre);
  return moved;
}

}  // namespace horopter
