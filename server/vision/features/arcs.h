// Elliptic arcs: images of the circles of bores and rounds.
#pragma once

#include <span>
#include <vector>

#include "server/vision/features/arc_seeds.h"
#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/features.h"

namespace horopter {

// Seeds from the chains grow along the gradient across them (FitRim); of those that share their
// rim the one of which most is seen stays. `chains` may hold an edge once per channel.
std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains,
                                 std::span<const GradientField> fields,
                                 int width,
                                 int height,
                                 const ArcOptions& options);

}  // namespace horopter
