// What is accepted: objects and scenes that chance does not explain. The values
// that decide stand in AcceptanceOptions and learnt_constants.h.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "server/vision/recognition/interpretation/alternative_hypotheses.h"
#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// Per object of the scene the most evidence of another object's placement in its place: how well
// chance, or a look-alike, fits there.
std::vector<double> BestCompeting(const JointContext& context,
                                  const SceneModel& scene,
                                  std::span<const PlacedObject> placements,
                                  std::span<const Alternative> alternatives = {});

// Leaves out the objects whose evidence the number of objects tried explains, see SceneLogOdds: of
// a catalog of 20 none.
void DropChanceObjects(const JointContext& context,
                       std::span<const PlacedObject> placements,
                       SceneModel* scene);

// Probability that a scene is no chance fit of wrong objects. Cameras, scale and plane adapt to the
// first object, so that a similar part may fit well alone; further objects in the same cameras, and
// edges that fit sharply, speak against chance. Logistic regression on scenes with all their parts
// enrolled against the same scenes with none of them (parts-train; tests/bench/results.md). Each
// object pays the multiple-testing penalty. But what chance does there is seen in those that came
// second: the evidence of an object that leads them by more is not the largest of many draws.
// best_competing: see BestCompeting; empty: nobody leads.
double SceneProbability(const JointContext& context,
                        const SceneModel& scene,
                        std::span<const double> best_competing = {});
// Its log odds, for comparing scenes.
double SceneLogOdds(const JointContext& context,
                    const SceneModel& scene,
                    std::span<const double> best_competing = {});

// Why a scene is no answer, or empty: more likely chance than not, or a focal length lies more
// prior deviations than may be from where the images alone, or the caller, put it (objects that
// force a camera so far are wrong).
std::string ReasonToDoubt(const JointContext& context,
                          const SceneModel& scene,
                          std::span<const double> best_competing = {});

// Leaves out the objects that are more likely wrong than right though the cameras are right: parts
// that share edges with what stands there fit it bluntly. The last object stays. alternatives: of
// the scene's objects, renumbered.
void DropUnlikelyObjects(const SceneAcceptance& acceptance,
                         SceneModel* scene,
                         std::vector<Alternative>* alternatives);

// That an object is right in cameras that are.
double ObjectProbability(const PlacedObject& placed);

}  // namespace horopter
