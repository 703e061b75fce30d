// From the scene that explains most to what is answered: objects, alternatives, refusal.
#pragma once

#include <span>
#include <string>
#include <vector>

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

// The same of a placement, with what the texture on its faces says.
double EvidenceOf(const PlacedObject& placed);

// How much evidence (log odds) chance gives the best of so many objects more than the best of the
// 20 that the verdict was learnt with: ln(n / 20), at least 0.
double PriceOfTrying(std::size_t objects);

// Per object of the scene the most evidence of another object's placement in its place: how well
// chance, or a look-alike, fits there.
std::vector<double> RunnersUp(const JointContext& context,
                              const SceneModel& scene,
                              std::span<const PlacedObject> placements,
                              std::span<const Rival> rivals = {});

// Leaves out the objects whose evidence the number of objects tried explains, see SceneLogOdds: of
// a catalog of 20 none.
void DropChanceObjects(const JointContext& context,
                       std::span<const PlacedObject> placements,
                       SceneModel* scene);

// Probability that a scene is no chance fit of wrong objects. Cameras, scale and plane adapt to the
// first object, so that a similar part may fit well alone; further objects in the same cameras, and
// edges that fit sharply, speak against chance. Logistic regression on scenes with all their parts
// enrolled against the same scenes with none of them (parts-train; tests/bench/results.md). Each
// object pays the price of trying. But what chance does there is seen in those that came second:
// the evidence of an object that leads them by more is not the largest of many draws. runners_up:
// see RunnersUp; empty: nobody leads.
double SceneProbability(const JointContext& context,
                        const SceneModel& scene,
                        std::span<const double> runners_up = {});
// Its log odds, for comparing scenes.
double SceneLogOdds(const JointContext& context,
                    const SceneModel& scene,
                    std::span<const double> runners_up = {});

// Why a scene is no answer, or empty: more likely chance than not, or a focal length lies more than
// four prior deviations from where the images alone, or the caller, put it (objects that force a
// camera so far are wrong).
std::string ReasonToDoubt(const JointContext& context,
                          const SceneModel& scene,
                          std::span<const double> runners_up = {});

// Leaves out the objects that are more likely wrong than right though the cameras are right: parts
// that share edges with what stands there fit it bluntly. The last object stays. rivals: of the
// scene's objects, renumbered.
void DropUnlikelyObjects(SceneModel* scene, std::vector<Rival>* rivals);

// State, cameras, objects with alternatives, and what was verified. trusted: the cameras do not
// hang on a single object. Several views without parallax answer nothing.
RecognitionResult MakeResult(const JointContext& context,
                             const SceneModel& scene,
                             std::span<const PlacedObject> verified,
                             std::span<const Rival> rivals,
                             bool trusted);

}  // namespace horopter
