// A camera whose lens and place are known.
#pragma once

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// The scene frame is the one in which the cameras of a set are given; whoever gives them says
// whether it is metric.
struct CalibratedCamera {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
};

}  // namespace horopter
