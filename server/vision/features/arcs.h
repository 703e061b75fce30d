// Elliptic arcs on edge chains: images of the circles of bores and rounds.
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Grows arcs along the chains as far as an ellipse fits to 0.6 px rms, keeps those that turn by at
// least 60 degrees and clearly leave their chord, and joins arcs of one ellipse. At most max_arcs,
// longest first.
std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains, int max_arcs);

}  // namespace horopter
