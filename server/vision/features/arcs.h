// Elliptic arcs on edge chains: images of the circles of bores and rounds.
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

struct ArcOptions {
  double max_rms_px = 0.7;      // of the points about the ellipse
  double min_sweep_rad = 1.0;   // of one run of points; higher: fewer rounded corners taken
  double min_sagitta_px = 1.5;  // how far a run must leave its chord
  double min_semi_minor_px = 2.0;
  double max_aspect = 10.0;
  int max_arcs = 400;  // the longest are kept
};

// Runs of chain that turn to one side give candidates, longest first; each ellipse then collects
// all edge points that lie on it with its direction, wherever they were linked, is fitted again to
// these (geometric distance) and spans what they cover. `chains` may hold an edge once per channel.
std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains,
                                 int width,
                                 int height,
                                 const ArcOptions& options);

}  // namespace horopter
