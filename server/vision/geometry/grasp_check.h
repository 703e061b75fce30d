// Whether a grasp fits the part it is stored with.
#pragma once

#include <string>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

struct GraspCheckOptions {
  // Difference of the stated width and the one between the faces, as a share of the opening, that
  // is let pass.
  double width_tolerance = 0.05;
  // How far before the grasp the fingers begin their approach, in diameters of the part.
  double approach_diameters = 1.0;
};

// What is wrong with each grasp, as "NAME: reason"; empty when all fit. Fingers are points at +-
// half the opening along x that come along z: they must not pass through the part, the closing line
// must meet the part between them, and the stated width must be that of the part there. A pre-grasp
// must lie before the grasp on the approach axis, turned the same way. The rim of a suction cup
// must meet the part in its middle and all around. Grasps need a closed mesh.
std::vector<std::string> CheckGrasps(const ObjectModel& model,
                                     const GraspCheckOptions& options = {});

}  // namespace horopter
