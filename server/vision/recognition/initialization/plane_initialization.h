// Scenes of one part each, when the scale of the cameras is not known yet.
#pragma once

#include <optional>
#include <vector>

#include "server/vision/recognition/candidates/plane_search.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// The reconstruction's cameras in metres with one part placed, refined and judged; empty when the
// refinement fails. world_from_object: metres.
std::optional<SceneModel> RefinedHypothesis(const JointContext& context,
                                            const Reconstruction& reconstruction,
                                            double units_per_metre,
                                            int object,
                                            const Rigid3& world_from_object);

// A scene of one part, and how many units of the reconstruction's frame it takes for a metre.
struct ScaledHypothesis {
  SceneModel scene;
  double units_per_metre = 1.0;
};

// One scene for each of the `max_scales` scales of the most evidence, best first: a scale's initial
// hypotheses tell the same cameras, and all of them speak for it. catalog: number of objects that
// were tried.
std::vector<SceneModel> BestScales(std::vector<ScaledHypothesis> starts,
                                   int max_scales,
                                   std::size_t catalog);

// Scenes of one part each, cameras from the reconstruction and scaled by the part; best first, at
// most EdgeSearchOptions::plane_scales different ones. Empty when the reconstruction has no two
// views.
std::vector<SceneModel> PlaneInitialScenes(const JointContext& context,
                                           const Reconstruction& reconstruction);

}  // namespace horopter
