// Cuts edge chains where they stop being straight, by chord distance and joint line fits (the
// default; the thesis's curvature methods are in chain_splitting.h).
#pragma once

#include <span>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Points [begin, end) of a chain.
struct ChainPiece {
  int begin = 0;
  int end = 0;
  bool curved = false;  // a conic's arc rather than a line; SplitAndMerge gives lines only
};

// Straight pieces in chain order; neighbouring pieces share their end point. Points that no piece
// of min_points covers are left out.
std::vector<ChainPiece> SplitAndMerge(std::span<const Eigen::Vector2f> points,
                                      const SplitAndMergeOptions& options);

}  // namespace horopter
