// Tests of one query against all entries of a node; internal to server/index. Plain loops over the
// dimension-major bounds, compiled for the widest vectors the machine has. Entries are independent
// and their dimensions are added in order, so every width gives the same bits.
#pragma once

#include <bit>
#include <cstdint>

#include "server/index/node.h"

namespace horopter::index_internal {

// Bit i: entry first + i meets the box [low, high]; of the 64 entries from `first` (a multiple of
// 64) on.
uint64_t MeetingEntries(const Node& node, int first, const double* low, const double* high);

// Calls visit(i) for every entry that meets the box, in order.
template <typename Visit>
void ForEachMeeting(const Node& node, const double* low, const double* high, Visit visit) {
  for (int first = 0; first < node.count; first += 64) {
    uint64_t meeting = MeetingEntries(node, first, low, high);
    for (; meeting != 0; meeting &= meeting - 1) visit(first + std::countr_zero(meeting));
  }
}

// Squared distances of the entries to a point. Stops early, leaving the sums so far, once all of
// them exceed `bound`; returns whether it did not.
bool SquaredDistances(const Node& node, const double* center, double bound, double* squared);

}  // namespace horopter::index_internal
