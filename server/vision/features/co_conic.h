// Which straight pieces and which arcs are the same edge (thesis 2.5, co-conic pieces).
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

struct CoConicOptions {
  double near_px = 1.2;       // of a segment's points from the arc
  double angle_rad = 0.35;    // between directions; a chord's ends turn by half of what it spans
  double chord_share = 0.75;  // of a segment along the arc: the segment is one of its chords
  // Of the arc along segments that go on straight beyond it: the arc only touches them and is
  // dropped.
  double max_straight_share = 0.35;
};

// Drops arcs that are made of straight edges and sets Segment::arc on the chords of the others.
// Returns the number of arcs dropped.
int ReconcileArcs(const CoConicOptions& options,
                  std::vector<EllipseArc>* arcs,
                  std::vector<Segment>* segments);

}  // namespace horopter
