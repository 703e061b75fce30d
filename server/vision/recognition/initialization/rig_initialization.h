// Parts anywhere before cameras that the reconstruction knows up to scale: a hypothesis of one view
// fixes the part's pose but for the scale, and the other views tell the scale.
#pragma once

#include <vector>

#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

struct RigInitializationOptions {
  int hypotheses_per_object = 3;  // best of each view
  int scale_steps = 48;
  // The part's depth tried, over the depth of the matched plane on its ray.
  double nearest = 0.35;
  double farthest = 1.6;
  float reach_px = 10.0f;  // working pixels
  double min_quick = 0.45;
  int refined = 24;
};

// Scenes of one part each, cameras from the reconstruction; largest description-length gain first.
// Uses the view hypotheses of the context. Empty with fewer than two reconstructed views.
std::vector<SceneModel> RigInitialScenes(const JointContext& context,
                                         const HypothesisTable& hypotheses,
                                         const Reconstruction& reconstruction,
                                         const RigInitializationOptions& options);

}  // namespace horopter
