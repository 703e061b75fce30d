// How an overflowing node is divided; internal to server/index.
#pragma once

#include <optional>
#include <vector>

#include "server/index/node.h"

namespace horopter::index_internal {

struct Split {
  std::vector<int> first;  // entries of the two halves
  std::vector<int> second;
  int dimension = 0;
  double overlap = 0.0;  // volume of the halves' intersection / volume of their union
};

// R*-tree (Beckmann et al. 1990, 4.2): the axis with the smallest sum of margins, on it the
// distribution with the smallest overlap, then volume. Each half gets >= min_count entries.
Split TopologicalSplit(const Node& node, int min_count);

// X-tree (4.2): along the dimensions that all entries' histories share, the balanced distribution
// with the smallest overlap. Nothing when no dimension is shared.
std::optional<Split> OverlapMinimalSplit(const Node& node, int min_count);

}  // namespace horopter::index_internal
