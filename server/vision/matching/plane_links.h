// The supporting plane's homographies between views: keypoints propose, patches decide.
#pragma once

#include <opencv2/core/mat.hpp>
#include <span>
#include <utility>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/matching/matching.h"

namespace horopter {

// The homographies found among `pairs` (first < second), one per pair at most, in their order; not
// yet checked against each other (ChainPlanes does). images: CV_8UC1 or CV_8UC3. Once `stop` asks,
// what was found so far.
std::vector<PlaneHomography> FindPlanes(std::span<const cv::Mat> images,
                                        const std::vector<std::pair<int, int>>& pairs,
                                        const MatchingOptions& options,
                                        const StopRequested& stop);

}  // namespace horopter
