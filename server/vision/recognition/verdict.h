// From the scene that explains most to what is answered: objects, alternatives, refusal.
#pragma once

#include <span>

#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/rivals.h"
#include "server/vision/recognition/scene_model.h"

namespace horopter {

// Largest angle (radians) under which two registered views see an object's centre; 0 with fewer
// than two views or without objects.
double LargestParallax(const JointContext& context, const SceneModel& scene);

// Whether a focal length lies more than four prior deviations from where the images alone, or the
// caller, put it: objects that force a camera so far are wrong.
bool ContradictsCameras(const JointContext& context, const SceneModel& scene);

// State, cameras, objects with alternatives, and what was verified. trusted: the cameras do not
// hang on a single object. Several views without parallax answer nothing.
RecognitionResult MakeResult(const JointContext& context,
                             const SceneModel& scene,
                             std::span<const PlacedObject> verified,
                             std::span<const Rival> rivals,
                             bool trusted);

}  // namespace horopter
