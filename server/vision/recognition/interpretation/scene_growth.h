// From a scene of one part to all that its cameras show: placements, the smallest set of them that
// explains most, joint refinement, again while objects are added (thesis 4.5).
#pragma once

#include <vector>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// thorough: all threads, several rounds, and a last look at what lost its support; otherwise one
// round on this thread, to compare initial hypotheses. verified (may be null) receives what was
// judged in the last round, accepted or not, best score first.
SceneModel ExpandScene(const JointContext& context,
                       const HypothesisTable& hypotheses,
                       SceneModel scene,
                       bool thorough,
                       std::vector<PlacedObject>* verified);

}  // namespace horopter
