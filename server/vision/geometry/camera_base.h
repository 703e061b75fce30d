// Where a camera is in the robot's base, and what that rests on. A value; server/vision/station
// corrects it.
#pragma once

#include <cstdint>

#include "server/vision/geometry/rigid3.h"

namespace horopter {

struct CameraBase {
  Rigid3 base_from_camera;
  // Standard deviations: of the rotation about each axis, of each coordinate of the camera's
  // centre.
  double rotation_sigma_rad = 0.01;
  double position_sigma_m = 0.005;
  bool learnt = false;        // from references; else people said it, and no request changes it
  std::int64_t requests = 0;  // that it was learnt from
};

}  // namespace horopter
