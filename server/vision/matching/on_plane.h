// Which segments lie on the supporting plane.
#pragma once

#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/matching_options.h"

namespace horopter {

// Per view and segment: a warped copy is found in >= 2 other views, or in the only other view that
// can judge it. A view can judge when it shares the plane, its pair has an F (so parallax exists),
// it sees the warped segment, and the segment is not along the epipolar line, where off-plane edges
// slide along themselves.
std::vector<std::vector<bool>> FindSegmentsOnPlane(std::span<const ImageFeatures> features,
                                                   const MatchingResult& matching,
                                                   const OnPlaneOptions& options = {});

}  // namespace horopter
