// Which straight pieces and which arcs are the same edge (thesis 2.5, co-conic pieces).
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Drops arcs that are made of straight edges and sets Segment::arc on the chords of the others.
// Returns the number of arcs dropped.
int ReconcileArcs(const CoConicOptions& options,
                  std::vector<EllipseArc>* arcs,
                  std::vector<Segment>* segments);

}  // namespace horopter
