// How far two poses of an object are apart in an image.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// Largest displacement (pixels) between the projections of two poses, over the corners of a cube
// about the object; a large number when a corner lies behind a camera.
inline double ProjectionDistance(const PreparedObject& object,
                                 const PinholeCamera& camera_a,
                                 const Rigid3& a,
                                 const PinholeCamera& camera_b,
                                 const Rigid3& b) {
  const Eigen::Vector3d half = Eigen::Vector3d::Constant(object.radius_m / std::sqrt(3.0));
  double largest = 0.0;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3d sign((corner & 1) ? 1 : -1, (corner & 2) ? 1 : -1, (corner & 4) ? 1 : -1);
    const Eigen::Vector3d x = object.center + sign.cwiseProduct(half);
    const Eigen::Vector3d in_a = a * x, in_b = b * x;
    if (in_a.z() < 1e-6 || in_b.z() < 1e-6) return 1e9;
    largest = std::max(largest, (Project(camera_a, in_a) - Project(camera_b, in_b)).norm());
  }
  return largest;
}

}  // namespace horopter
