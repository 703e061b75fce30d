// Which segments lie on the supporting plane.
#pragma once

#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/matching/matching.h"

namespace horopter {

struct OnPlaneOptions {
  double max_distance_px = 1.5;   // of the warped segment's ends from the found one's line
  double max_angle_rad = 0.0698;  // 4 degrees
  double min_overlap = 0.5;       // of the warped segment
  double min_epipolar_angle_rad =
      0.1745;  // 10 degrees: a segment along the epipolar line never leaves it
};

// Per view and segment: a warped copy is found in >= 2 other views, or in the only other view that
// can judge it. A view can judge when it shares the plane, its pair has an F (so parallax exists),
// it sees the warped segment, and the segment is not along the epipolar line, where off-plane edges
// slide along themselves.
std::vector<std::vector<bool>> FindSegmentsOnPlane(std::span<const ImageFeatures> features,
                                                   const MatchingResult& matching,
                                                   const OnPlaneOptions& options = {});

}  // namespace horopter
