// From the scene that explains most to what is answered: objects, alternatives, refusal.
#pragma once

#include <span>
#include <string>

#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/rivals.h"
#include "server/vision/recognition/scene_model.h"

namespace horopter {

// Largest angle (radians) under which two registered views see an object's centre; 0 with fewer
// than two views or without objects.
double LargestParallax(const JointContext& context, const SceneModel& scene);

// What one object says for the scene's cameras and scale, in units of log odds; 0 for support that
// chance may give. support: see JointScore; sharpness: EdgeSupport::Sharpness over all views.
double Evidence(double support, double sharpness);

// Probability that a scene is no chance fit of wrong objects. Cameras, scale and plane adapt to the
// first object, so that a similar part may fit well alone; further objects in the same cameras, and
// edges that fit sharply, speak against chance. catalog_size: the more objects were tried, the
// better the best chance fit. Logistic regression on scenes with all their parts enrolled against
// the same scenes with none of them (parts-train; tests/bench/results.md).
double SceneProbability(const JointContext& context, const SceneModel& scene);

// Why a scene is no answer, or empty: more likely chance than not, or a focal length lies more than
// four prior deviations from where the images alone, or the caller, put it (objects that force a
// camera so far are wrong).
std::string ReasonToDoubt(const JointContext& context, const SceneModel& scene);

// State, cameras, objects with alternatives, and what was verified. trusted: the cameras do not
// hang on a single object. Several views without parallax answer nothing.
RecognitionResult MakeResult(const JointContext& context,
                             const SceneModel& scene,
                             std::span<const PlacedObject> verified,
                             std::span<const Rival> rivals,
                             bool trusted);

}  // namespace horopter
