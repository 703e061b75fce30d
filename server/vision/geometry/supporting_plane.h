// The plane that parts stand on.
#pragma once

#include <Eigen/Core>

namespace horopter {

// Plane {x : normal . x = offset_m} in the scene frame, metres; the unit normal points to the side
// of the cameras.
struct SupportingPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset_m = 0.0;
};

}  // namespace horopter
