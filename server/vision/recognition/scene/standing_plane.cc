#include "server/vision/recognition/scene/standing_plane.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <cmath>
#include <vector>

namespace horopter {
namespace {

constexpr int kIterations = 10;  // of reweighting

}  // namespace

SupportingPlane PlaneUnderObjects(const JointContext& context,
                                  std::span<const PlacedObject> models,
                                  const SupportingPlane& plane) {
  const StandingPlaneOptions& options = context.options.search.standing_plane;
  std::vector<Eigen::Vector3d> feet;
  int standing = 0;
  for (const PlacedObject& p : models) {
    const PreparedObject& object = *context.objects[p.object];
    for (const StablePose& pose : object.stable_poses) {
      const Eigen::Vector3d up = p.scene_from_object.R * pose.up;
      if (up.dot(plane.normal) < std::cos(options.upright_rad)) continue;
      const double height = plane.normal.dot(p.scene_from_object * object.center) - plane.offset_m -
                            pose.up.dot(object.center) - pose.height_m;
      if (std::abs(height) > options.near_m) continue;
      for (const Eigen::Vector3d& foot : Footprint(object, pose))
        feet.push_back(p.scene_from_object * foot);
      ++standing;
      break;
    }
  }
  if (standing < options.min_objects || feet.size() < 3) return plane;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& f : feet) middle += f / static_cast<double>(feet.size());
  const Eigen::Vector3d x = plane.normal.unitOrthogonal(), y = plane.normal.cross(x);
  // Height over the given plane = c + a x + b y about the feet's middle.
  Eigen::Vector3d abc = Eigen::Vector3d::Zero();
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const double tilt = 1.0 / (options.tilt_sigma_rad * options.tilt_sigma_rad);
    const double offset = 1.0 / (options.offset_sigma_m * options.offset_sigma_m);
    Eigen::Matrix3d N = Eigen::Vector3d(tilt, tilt, offset).asDiagonal();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& f : feet) {
      const Eigen::Vector3d row((f - middle).dot(x), (f - middle).dot(y), 1.0);
      const double height = plane.normal.dot(f) - plane.offset_m;
      const double r = (height - row.dot(abc)) / options.robust_scale_m;
      const double weight = 1.0 / ((1.0 + r * r) * options.foot_sigma_m * options.foot_sigma_m);
      N += weight * row * row.transpose();
      g += weight * height * row;
    }
    abc = N.ldlt().solve(g);
  }
  if (!abc.allFinite()) return plane;
  SupportingPlane out;
  out.normal = (plane.normal - abc(0) * x - abc(1) * y).normalized();
  out.offset_m =
      out.normal.dot(middle - (plane.normal.dot(middle) - plane.offset_m - abc(2)) * plane.normal);
  return out;
}

}  // namespace horopter
