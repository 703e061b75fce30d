// What the images show beyond the objects that are found: one scene feature serves one object, and
// a half hidden part stands out once its neighbours' edges are gone.
#pragma once

#include <vector>

#include "server/vision/recognition/scene_model.h"

namespace horopter {

struct RemainingEvidence {
  // Without edge chains; segments that objects explain are marked as texture, which starts no
  // hypothesis.
  std::vector<ImageFeatures> features;
  JointContext context;  // of these features, without view hypotheses; no maps where no camera is
};

// The evidence without the edges that the scene's objects show, hidden behind each other where they
// are, if they say at least `sure_evidence` (log odds, see verdict.h). Refers to `context`'s
// objects and matches.
RemainingEvidence WithoutExplained(const JointContext& context,
                                   const SceneModel& scene,
                                   double sure_evidence);

}  // namespace horopter
