// What the images show beyond the objects that are found: one scene feature serves one object, and
// a half hidden part stands out once its neighbours' edges are gone.
#pragma once

#include <memory>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

struct RemainingEvidence {
  // Without edge chains; segments that objects explain are marked as texture, which starts no
  // hypothesis. `context` points into them: copies share them.
  std::shared_ptr<const std::vector<ImageFeatures>> features;
  // Of these features, for a search under known cameras: without start
  // cameras; no maps where no camera is.
  JointContext context;
};

// The evidence without the edges that the scene's objects show, hidden behind each other where they
// are, if they say at least `sure_evidence` (log odds, see log_odds.h). Refers to `context`'s
// objects and matches.
RemainingEvidence WithoutExplained(const JointContext& context,
                                   const SceneModel& scene,
                                   double sure_evidence);

}  // namespace horopter
