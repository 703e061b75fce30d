// Corners: where segments end near their intersection.
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Joins segments whose ends lie within min(junction_gap_px, junction_gap_fraction x length) of a
// common intersection and which enclose at least junction_min_angle_rad; the point is the
// least-squares intersection of all lines that meet. A segment that ends on the middle of another
// one gives a junction (T) in which the passing one is `interior`. Chords of one arc make none.
std::vector<Junction> FindJunctions(const std::vector<Segment>& segments,
                                    const FeatureOptions& options);

// Type of a junction from the directions in which its segments leave it.
JunctionType TypeOf(const Junction& junction, const std::vector<Segment>& segments);

}  // namespace horopter
