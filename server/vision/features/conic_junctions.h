// Where straight edges meet circular ones.
#pragma once

#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Intersections of each segment's line with the arcs near its ends. A line that passes the ellipse
// within 1 px of touching it meets it at the foot of the perpendicular (tangent continuation).
// Chords of an arc (Segment::arc) do not meet that arc. The covariance is the line's, carried to
// the intersection along the ellipse's tangent, and the arc's own rms over its length.
std::vector<ConicJunction> FindConicJunctions(const std::vector<Segment>& segments,
                                              const std::vector<EllipseArc>& arcs,
                                              const ConicJunctionOptions& options);

}  // namespace horopter
