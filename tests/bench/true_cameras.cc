#include "tests/bench/true_cameras.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace horopter {
namespace {

constexpr double kUnitM = 0.37;
constexpr double kLeastTurnRad = 1e-4, kLeastPosition = 1e-3, kLeastFocal = 1e-3;

// Of each image; empty: not known.
std::vector<Rigid3> TruePoses(const BopScene& scene) {
  std::vector<Rigid3> out;
  if (std::all_of(
          scene.images.begin(), scene.images.end(), [](const BopImage& i) { return i.has_pose; })) {
    for (const BopImage& image : scene.images) out.push_back(image.camera_from_world);
    return out;
  }
  for (const BopInstance& first : scene.images.front().instances) {
    out.clear();
    for (const BopImage& image : scene.images) {
      const BopInstance* only = nullptr;
      int count = 0;
      for (const BopInstance& i : image.instances) {
        if (i.obj_id == first.obj_id) only = &i, ++count;
      }
      if (count == 1) out.push_back(only->camera_from_object);
    }
    if (out.size() == scene.images.size()) return out;
  }
  return {};
}

}  // namespace

KnownCameras DisturbedCameras(const BopScene& scene, double turn_deg, double focal_share) {
  KnownCameras known;
  known.views.resize(scene.images.size());
  const std::vector<Rigid3> poses = TruePoses(scene);
  if (poses.empty()) return known;
  std::mt19937 random(static_cast<unsigned>(scene.scene_id));
  std::normal_distribution<double> normal(0.0, 1.0);
  const double turn_rad = turn_deg * std::numbers::pi / 180.0;
  const double of_set = focal_share * normal(random);
  for (std::size_t v = 0; v < poses.size(); ++v) {
    CalibratedView& view = known.views[v].emplace();
    view.camera = scene.images[v].camera;
    const double ratio = std::exp(of_set + 0.5 * focal_share * normal(random));
    view.camera.focal_px *= ratio;
    view.camera_from_scene = poses[v];
    const BopInstance* seen =
        scene.images[v].instances.empty() ? nullptr : &scene.images[v].instances.front();
    const double depth = seen != nullptr ? seen->camera_from_object.t.z() : poses[v].t.norm();
    view.camera_from_scene.t.z() += depth * (ratio - 1.0);
    const Eigen::Vector3d turn =
        turn_rad * Eigen::Vector3d(normal(random), normal(random), normal(random));
    if (turn.norm() > 0) {
      const Eigen::Matrix3d R =
          Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
      view.camera_from_scene = {R * view.camera_from_scene.R, R * view.camera_from_scene.t};
    }
    view.camera_from_scene.t /= kUnitM;
    view.focal_log_sigma = std::max(kLeastFocal, focal_share);
  }
  known.rotation_sigma_rad = std::max(kLeastTurnRad, turn_rad);
  known.position_sigma = std::max(kLeastPosition, turn_rad);
  return known;
}

}  // namespace horopter
