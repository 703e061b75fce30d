// Fine texture apart from structure.
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Sets in_texture on short segments that lie among many other short edge pieces and are not tied
// into structure: they close no corner on both ends and touch no long segment. Nothing is deleted.
// Returns the number marked.
int MarkTexture(const std::vector<EdgeChain>& chains,
                const std::vector<Junction>& junctions,
                const FeatureOptions& options,
                int width,
                int height,
                std::vector<Segment>* segments);

}  // namespace horopter
