// Joining pieces of one straight edge: across gaps, and across the channels that see the same edge.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/features/segment_fit.h"

namespace horopter {

// Joins collinear pieces: directions within merge_angle_rad, ends within merge_offset_px of the
// other's line, gap along the line at most merge_gap_px. Duplicates of several channels become one
// segment that carries the channel, polarity and contrast of its strongest piece (length x
// contrast). Strongest first in the result.
std::vector<Segment> MergeSegments(std::vector<FittedSegment> pieces,
                                   const FeatureOptions& options);

}  // namespace horopter
