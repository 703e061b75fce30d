// Parts anywhere before cameras that the reconstruction knows up to scale: a hypothesis of one view
// fixes the part's pose but for the scale, and the other views tell the scale.
#pragma once

#include <vector>

#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// Scenes of one part each, cameras from the reconstruction; largest description-length gain first.
// Uses the view hypotheses of the context. Empty with fewer than two reconstructed views.
std::vector<SceneModel> RigInitialScenes(const JointContext& context,
                                         const HypothesisTable& hypotheses,
                                         const Reconstruction& reconstruction);

}  // namespace horopter
