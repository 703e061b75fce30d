#include "server/pipeline/base_frame.h"

#include <Eigen/Dense>
#include <cmath>
#include <cstdio>

namespace horopter {
namespace {

constexpr double kDegrees = 180.0 / 3.14159265358979323846;
// The recovered cameras' own share: rotations, and centres relative to their distance.
constexpr double kRecoveredRad = 0.005;
constexpr double kRecoveredDistance = 0.01;

struct Opinion {
  int view = -1;
  Rigid3 base_from_scene;
  Eigen::Vector3d centre_in_base = Eigen::Vector3d::Zero();
  Eigen::Vector3d centre_in_scene = Eigen::Vector3d::Zero();
  double rotation_sigma_rad = 0.0;
  double position_sigma_m = 0.0;
};

std::vector<Opinion> Opinions(std::span<const std::optional<CameraPoseHint>> poses,
                              std::span<const std::optional<PosedCamera>> cameras) {
  std::vector<Opinion> out;
  for (size_t v = 0; v < poses.size() && v < cameras.size(); ++v) {
    if (!poses[v] || !cameras[v]) continue;
    const Rigid3 base_from_camera = poses[v]->camera_from_base.Inverse();
    Opinion o;
    o.view = static_cast<int>(v);
    o.base_from_scene = base_from_camera * cameras[v]->camera_from_scene;
    o.centre_in_base = base_from_camera.t;
    o.centre_in_scene = cameras[v]->camera_from_scene.Inverse().t;
    o.rotation_sigma_rad = std::hypot(poses[v]->rotation_sigma_rad, kRecoveredRad);
    o.position_sigma_m = std::hypot(poses[v]->position_sigma_m,
                                    kRecoveredDistance * cameras[v]->camera_from_scene.t.norm());
    out.push_back(o);
  }
  return out;
}

// Empty when they agree: in rotation, and in the distance of their centres, which no frame changes.
std::string Conflict(const Opinion& a, const Opinion& b) {
  const double angle =
      Eigen::AngleAxisd(a.base_from_scene.R * b.base_from_scene.R.transpose()).angle();
  const double distance = std::abs((a.centre_in_base - b.centre_in_base).norm() -
                                   (a.centre_in_scene - b.centre_in_scene).norm());
  const double angle_sigma = std::hypot(a.rotation_sigma_rad, b.rotation_sigma_rad);
  const double distance_sigma = std::hypot(a.position_sigma_m, b.position_sigma_m);
  if (angle <= kMaxHintDeviations * angle_sigma &&
      distance <= kMaxHintDeviations * distance_sigma) {
    return {};
  }
  char text[240];
  std::snprintf(text,
                sizeof(text),
                "camera hints of images %d and %d contradict each other: the images differ from "
                "them by %.1f degrees and %.1f mm, deviations %.1f degrees and %.1f mm",
                a.view,
                b.view,
                kDegrees * angle,
                1e3 * distance,
                kDegrees * angle_sigma,
                1e3 * distance_sigma);
  return text;
}

}  // namespace

BaseFrame BaseFromCameras(std::span<const std::optional<CameraPoseHint>> poses,
                          std::span<const std::optional<PosedCamera>> cameras) {
  BaseFrame out;
  const std::vector<Opinion> opinions = Opinions(poses, cameras);
  if (opinions.empty()) return out;
  for (size_t i = 0; i < opinions.size(); ++i) {
    for (size_t j = i + 1; j < opinions.size(); ++j) {
      out.conflict = Conflict(opinions[i], opinions[j]);
      if (!out.conflict.empty()) return out;
    }
  }
  // Rotation: nearest to the weighted sum; place: so that the weighted mean of the centres agrees.
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  Eigen::Vector3d in_base = Eigen::Vector3d::Zero(), in_scene = Eigen::Vector3d::Zero();
  double weights = 0.0;
  for (const Opinion& o : opinions) {
    sum += o.base_from_scene.R / (o.rotation_sigma_rad * o.rotation_sigma_rad);
    const double w = 1.0 / (o.position_sigma_m * o.position_sigma_m);
    in_base += w * o.centre_in_base;
    in_scene += w * o.centre_in_scene;
    weights += w;
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Rigid3 base_from_scene;
  base_from_scene.R = svd.matrixU() * svd.matrixV().transpose();
  if (base_from_scene.R.determinant() < 0.0) return out;
  base_from_scene.t = (in_base - base_from_scene.R * in_scene) / weights;
  out.base_from_scene = base_from_scene;
  return out;
}

}  // namespace horopter
