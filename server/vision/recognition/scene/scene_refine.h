// Joint Gauss-Newton over cameras and objects of a scene hypothesis. Quick and without covariance:
// the euclidean stage does the final adjustment.
#pragma once

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// Refines focal lengths, camera poses and object poses (the first object is fixed, it fixes the
// gauge) on the visible edges and on the plane's matched texture: a small part alone says little
// about the cameras. Leaves the scene unchanged and returns false when the system cannot
// be solved.
bool RefineScene(const JointContext& context, const SceneRefineOptions& options, SceneModel* scene);
bool RefineScene(const JointContext& context, SceneModel* scene);  // as the request has them

}  // namespace horopter
