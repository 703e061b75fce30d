// First guesses of ellipses from edge chains.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/features/split_and_merge.h"

namespace horopter {

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
