// What is known of the cameras of one cell: a joint Gaussian over their intrinsics and their places
// in the rig. A value; server/vision/station makes and changes it.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Parameters of a camera: perturbation (w, dt) of camera_from_rig (radians, metres; as
// euclidean/pose_perturbation.h), log f, cx, cy (pixels), k1.
inline constexpr int kStationCameraParameters = 10;
inline constexpr int kStationIntrinsics = 6;  // where log f begins among them

struct StationCamera {
  std::string id;
  PinholeCamera camera;  // mean; its size is that of the images
  bool moving = false;   // declared: only the intrinsics are kept
  bool zooming = false;  // declared: the intrinsics are of one request
  bool posed = false;    // camera_from_rig is known
  Rigid3 camera_from_rig;
  std::int64_t requests = 0;  // that said something of it since it was forgotten
};

struct StationState {
  std::vector<StationCamera> cameras;
  // Joint covariance, ten rows a camera in the order of `cameras`. The rows of a pose that is not
  // known are zero, as are those of the camera that holds the rig's frame.
  Eigen::MatrixXd covariance;
  std::int64_t requests = 0;
};

}  // namespace horopter
