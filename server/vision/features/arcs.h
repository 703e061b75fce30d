// Elliptic arcs: images of the circles of bores and rounds.
#pragma once

#include <span>
#include <vector>

#include "server/vision/features/arc_seeds.h"
#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/features.h"

namespace horopter {

struct ArcOptions {
  ArcSeedOptions seeds;
  double min_sweep_rad = 1.0;       // of an arc grown from one run
  double min_pair_sweep_rad = 4.0;  // ... from two bows, which prove less by themselves
  double min_seen_share = 0.7;      // of the arc's sweep with a gradient across it
  double max_covered_share = 0.8;   // of an arc by better ones; more: it is dropped
  int max_arcs = 400;               // those of which most is seen are kept
};

// Seeds from the chains grow along the gradient across them (FitRim); of those that share their
// rim the one of which most is seen stays. `chains` may hold an edge once per channel.
std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains,
                                 std::span<const GradientField> fields,
                                 int width,
                                 int height,
                                 const ArcOptions& options);

}  // namespace horopter
