// Planes that parts of a scene stand on.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/aspect_adjustment.h"

namespace horopter {

// normal . x = offset, scene frame, metres; cameras are on the side the unit normal points to.
struct StandingPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset_m = 0.0;
  int objects = 0;  // that rest on it
};

// The plane on which most objects rest by one of their faces, below no camera and with no object
// under it; then those parallel to it on which others rest: the tops of blocks. Empty without
// views, objects or such a plane.
std::vector<StandingPlane> PlanesUnder(std::span<const AspectSceneObject> objects,
                                       std::span<const AspectPart> parts,
                                       const std::vector<std::optional<AspectSceneView>>& views);

}  // namespace horopter
