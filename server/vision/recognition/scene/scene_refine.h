// Joint Gauss-Newton over cameras and objects of a scene hypothesis. Quick and without covariance:
// the euclidean stage does the final adjustment.
#pragma once

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

struct SceneRefineOptions {
  int iterations = 8;
  double start_reach_px = 8.0;
  double end_reach_px = 3.0;
  int plane_matches = 240;    // at most, of all pairs
  double plane_weight = 0.5;  // of a plane match against an edge sample
};

// Refines focal lengths, camera poses and object poses (the first object is fixed, it fixes the
// gauge) on the visible edges and on the plane's matched texture: a small part alone says little
// about the cameras. Leaves the scene unchanged and returns false when the system cannot
// be solved.
bool RefineScene(const JointContext& context, const SceneRefineOptions& options, SceneModel* scene);

}  // namespace horopter
