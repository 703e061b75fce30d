// Links of two views by a hypothesis of each for the same part: initial hypotheses of a scene.
#pragma once

#include <optional>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/aspect_scenes/hypothesis_support.h"
#include "server/vision/recognition/aspect_scenes/link_turns.h"

namespace horopter {

// A placed object and the hypotheses of views that say so.
struct GrownObject {
  AspectSceneObject placed;
  std::vector<int> hypothesis;  // of each view, -1: none
};

// Some views linked, and what they agree on.
struct GrownScene {
  std::vector<std::optional<AspectSceneView>> views;
  std::vector<GrownObject> objects;
  double support = 0.0;
};

// Best first, of each pair of views only a few; of one image alone the parts of its best
// hypotheses. Fewer when stopped.
std::vector<GrownScene> LinkPairs(const AspectLinkInput& input,
                                  const AspectLinkOptions& options,
                                  const HypothesisSupport& support,
                                  const LinkTurns& turns,
                                  const StopRequested& stop);

}  // namespace horopter
