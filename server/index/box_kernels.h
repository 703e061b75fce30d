// Tests of one query against all entries of a node; internal to server/index. Plain loops over the
// dimension-major bounds, compiled for the widest vectors the machine has. Entries are independent
// and their dimensions are added in order, so every width gives the same bits.
#pragma once

#include "server/index/node.h"

namespace horopter::index_internal {

// excess[i] <= 0 exactly when entry i meets the box [low, high].
void BoxExcess(const Node& node, const double* low, const double* high, double* excess);

// Squared distances of the entries to a point. Stops early, leaving the sums so far, once all of
// them exceed `bound`; returns whether it did not.
bool SquaredDistances(const Node& node, const double* center, double bound, double* squared);

}  // namespace horopter::index_internal
