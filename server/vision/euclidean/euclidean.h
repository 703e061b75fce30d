// One metric frame for cameras and objects, with covariance, and the grasps in it (thesis 5).
#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

using Matrix6d = Eigen::Matrix<double, 6, 6>;

struct PosedCamera {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
  double focal_log_sigma = 0.0;
};

struct PosedObject {
  int object = -1;
  Rigid3 scene_from_object;
  // Of (rotation vector about the scene axes at the object's origin [rad], translation [m]), left
  // perturbation: scene_from_object = (exp(w) R, t + dt).
  Matrix6d covariance = Matrix6d::Zero();
  double score = 0.0;
  std::vector<double> view_scores;
  std::vector<int> alternatives;
  int edge_observations = 0;
  double rms_px = 0.0;
};

struct MetricScene {
  std::vector<std::optional<PosedCamera>> cameras;
  std::vector<PosedObject> objects;
  double rms_px = 0.0;
  std::map<std::string, double> counts;
};

struct EuclideanOptions {
  double focal_log_sigma = 0.35;        // weak prior on log f about its start
  double principal_point_sigma = 0.01;  // of the image width, prior on the offset from the centre
  double search_px = 4.0;               // edge points are looked for this far along the edge normal
  double edge_sigma_px = 0.35;          // of one edge point; the residual rescales it
  int rounds = 3;                       // re-association rounds
};

// Joint bundle adjustment of focal lengths, camera poses and object poses on the CAD edges seen in
// the images. The scene frame is fixed to the first object (its pose stays the identity-covariance
// reference of the answer). Errors: INVALID_ARGUMENT, CANCELLED, FAILED_PRECONDITION (no object or
// no camera).
absl::StatusOr<MetricScene> RefineMetricScene(const RecognitionInput& input,
                                              const RecognitionResult& recognition,
                                              const EuclideanOptions& options,
                                              const StopRequested& stop = {});

// A grasp of a recognised object in the scene frame, expanded over the object's symmetries by the
// caller's wish.
struct SceneGrasp {
  std::string name;
  int symmetry = 0;  // 0: identity, k: ObjectModel::symmetries[k-1]
  Rigid3 scene_from_gripper;
  double jaw_opening_m = 0.0;
  double grip_width_m = 0.0;
  double quality = 0.0;
  std::optional<Rigid3> scene_from_pregrasp;
};

std::vector<SceneGrasp> GraspsInScene(const ObjectModel& model, const Rigid3& scene_from_object);

}  // namespace horopter
