// Nearest descriptors of two sets of keypoints.
#pragma once

#include <utility>
#include <vector>

#include "server/vision/features/keypoints.h"
#include "server/vision/matching/homography.h"

namespace horopter {

// Mutual nearest neighbours that pass the ratio test on one side, best ratio first: indices into a
// and b.
std::vector<std::pair<int, int>> MatchKeypointIndices(const KeypointSet& a,
                                                      const KeypointSet& b,
                                                      double ratio);

// The same as places in the images.
std::vector<PointPair> MatchKeypoints(const KeypointSet& a, const KeypointSet& b, double ratio);

}  // namespace horopter
