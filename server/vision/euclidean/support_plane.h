// The plane the recognised parts stand on, for whoever must not reach through it.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "server/vision/euclidean/scene_bundle.h"

namespace horopter {

// Plane {x : normal . x = offset_m} in the scene frame, normal towards the cameras.
struct SupportPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset_m = 0.0;
};

// From the plane's matched points; without them the stable pose of an object below which no other
// object and no camera lies, and on which most objects stand. Lowered until nothing stands in it.
// Empty when no stable pose of any object leaves all others above.
std::optional<SupportPlane> FindSupportPlane(const SceneBundle& bundle);

}  // namespace horopter
