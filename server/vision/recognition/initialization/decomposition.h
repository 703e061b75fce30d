// From the collineations of the recognised objects to one metric frame and a rigid transform per
// object (thesis 5.3).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/projection.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// A = Q S, Q the rotation nearest to A, S symmetric.
struct PolarFactors {
  Eigen::Matrix3d Q = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d S = Eigen::Matrix3d::Identity();
};
// Newton's iteration with Higham's scaling (1986). Empty unless A is finite, regular and det A > 0.
std::optional<PolarFactors> PolarDecomposition(const Eigen::Matrix3d& A);

// A recognised object in a projective scene.
struct CollineatedObject {
  Eigen::Matrix4d scene_from_object;              // collineation, up to scale
  std::vector<Eigen::Vector3d> points_in_object;  // metres; not all in one plane, 4 at least
  std::vector<Eigen::Vector4d> points_in_scene;   // of the same points, homogeneous; empty: mapped
};

struct Decomposition {
  Eigen::Matrix4d metric_from_scene = Eigen::Matrix4d::Identity();  // the upgrade U
  std::vector<Rigid3> metric_from_object;  // of the first object the identity
  // Largest over smallest singular value of each object's affine part under the upgrade: 1 for a
  // consistent object, far from 1 for one that is something else.
  std::vector<double> stretch;
  double rms_m = 0.0;  // between the objects' points and the upgraded scene's
};

// All return INVALID_ARGUMENT without objects or with unusable points, FAILED_PRECONDITION when a
// collineation is singular, mirrors its object or sends its points through the plane at infinity.

// The first object alone gives the upgrade, every other one its polar factor.
absl::StatusOr<Decomposition> DecomposePerObject(std::span<const CollineatedObject> objects);

// The same start; then in turn one upgrade from all objects (linear collineation of the scene's
// points to where the objects put them) and the rigid transforms (absolute orientation).
struct CommonUpgradeOptions {
  int iterations = 60;
};
absl::StatusOr<Decomposition> DecomposeCommon(std::span<const CollineatedObject> objects,
                                              const CommonUpgradeOptions& options = {});

// The alternative nonlinear update (thesis 5.3.4): upgrade (15 parameters) and transforms (6 each,
// the first fixed) together, Levenberg-Marquardt on the distances in the metric frame.
absl::StatusOr<Decomposition> RefineDecomposition(std::span<const CollineatedObject> objects,
                                                  const Decomposition& start);

// A point of an object seen in an image.
struct ObjectPointObservation {
  int view = -1;
  int object = -1;
  Eigen::Vector3d point_in_object = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
};

// ... on the distances in the images, through the projective cameras, which are fixed.
absl::StatusOr<Decomposition> RefineInImages(std::span<const CollineatedObject> objects,
                                             std::span<const std::optional<CameraMatrix>> cameras,
                                             std::span<const ObjectPointObservation> observations,
                                             const Decomposition& start);

// Camera with square pixels nearest to a projective one under the upgrade: P U^-1 = K [R | t].
// Empty when it is singular or sees the metric frame's origin behind it.
struct MetricCamera {
  PinholeCamera camera;
  Rigid3 camera_from_metric;
};
std::optional<MetricCamera> UpgradeCamera(const CameraMatrix& P,
                                          const Eigen::Matrix4d& metric_from_scene,
                                          int width,
                                          int height);

}  // namespace horopter
