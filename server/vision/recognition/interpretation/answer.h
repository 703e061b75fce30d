// From the scene that explains most to what is answered: state, objects, alternatives.
#pragma once

#include <span>

#include "server/vision/recognition/interpretation/alternative_hypotheses.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/types.h"

namespace horopter {

// Largest angle (radians) under which two registered views see an object's centre; 0 with fewer
// than two views or without objects.
double LargestParallax(const JointContext& context, const SceneModel& scene);

// State, cameras, objects with alternatives, and what was verified. best_competing: see decision.h.
// trusted: the cameras do not
// hang on a single object. Several views without parallax answer nothing.
RecognitionResult MakeResult(const JointContext& context,
                             const SceneModel& scene,
                             std::span<const PlacedObject> verified,
                             std::span<const double> best_competing,
                             std::span<const Alternative> alternatives,
                             bool trusted);

}  // namespace horopter
