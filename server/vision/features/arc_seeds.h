// First guesses of ellipses from edge chains.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/features/split_and_merge.h"

namespace horopter {

struct ArcSeedOptions {
  double max_rms_px = 0.7;      // of the points about the ellipse
  double min_sweep_rad = 1.0;   // of one run of points; higher: fewer rounded corners taken
  double min_sagitta_px = 1.5;  // how far a run must leave its chord
  double min_semi_minor_px = 2.0;
  double max_aspect = 10.0;
  int max_run_seeds = 150;          // of the longest runs; higher: slower in texture
  int max_bows = 500;               // bows paired at most, the strongest
  int partners = 6;                 // tried for each bow, the nearest
  double max_bow_distance_px = 90;  // between the middles of two that are paired
  double max_pair_rms_px = 0.4;
  int max_pairs = 150;  // the best fits are kept
};

// Could this be the image of a part's circle?
bool IsPlausibleEllipse(const EllipseArc& arc, const ArcSeedOptions& options);

// Close chords (0.6 px) of each chain, which the seeds below are made of.
std::vector<std::vector<ChainPiece>> ChordsOf(const std::vector<EdgeChain>& chains);

// Runs of chain that turn to one side, longest first: the whole of each, then what is left without
// a few chords at its ends, which may be straight edges that run into the arc. Rounded corners of
// two straight edges are left out. Ends at max_run_seeds.
std::vector<EllipseArc> SeedsOfRuns(const std::vector<EdgeChain>& chains,
                                    const std::vector<std::vector<ChainPiece>>& chords,
                                    int width,
                                    int height,
                                    const ArcSeedOptions& options);

// Pairs of short bows that face each other: the rim of a bore is often broken where light and
// shade of its wall meet, and each chain then leaves the rim there.
std::vector<EllipseArc> SeedsOfPairs(const std::vector<EdgeChain>& chains,
                                     const std::vector<std::vector<ChainPiece>>& chords,
                                     const ArcSeedOptions& options);

}  // namespace horopter
