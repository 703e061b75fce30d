// Edge chains of all channels with sub-pixel points, each edge once.
#pragma once

#include <vector>

#include "server/vision/features/detection_channels.h"
#include "server/vision/features/edge_drawing.h"
#include "server/vision/features/features.h"

namespace horopter {

// Moves every chain pixel to the gradient peak across the chain (parabola, at most 1 px) and drops
// runs that a longer chain of another channel already covers (within 1.5 px and 30 degrees). Runs
// shorter than 6 points are dropped.
std::vector<EdgeChain> JoinChains(const std::vector<DrawnEdges>& edges,
                                  const std::vector<DetectionChannel>& channels);

}  // namespace horopter
