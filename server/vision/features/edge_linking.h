// Canny edges as ordered sub-pixel chains: non-maximum suppression, hysteresis and linking along
// the ridge of the gradient (thesis 2.2; the walk is that of edge drawing, Topal & Akinlar 2012).
#pragma once

#include <vector>

#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/features.h"

namespace horopter {

// Chains that meet share a point: one that runs into another ends on it. Points carry the gradient.
// Strong edges are walked first. The result depends on the field alone.
std::vector<EdgeChain> LinkEdges(const GradientField& field, const LinkingOptions& options);

}  // namespace horopter
