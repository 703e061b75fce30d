// The supporting plane's homographies between views: keypoints propose, patches decide.
#pragma once

#include <opencv2/core/mat.hpp>
#include <span>
#include <utility>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/matching/matching.h"

namespace horopter {

struct FoundPlanes {
  // One per pair at most, in the pairs' order; not yet checked against each other (ChainPlanes
  // does).
  std::vector<PlaneHomography> planes;
  // Views full of repeated texture, which are linked to nothing: a homography a period off would
  // look as right.
  int ambiguous_views = 0;
};

// The homographies found among `pairs` (first < second). images: CV_8UC1 or CV_8UC3. Once `stop`
// asks, what was found so far.
FoundPlanes FindPlanes(std::span<const cv::Mat> images,
                       const std::vector<std::pair<int, int>>& pairs,
                       const MatchingOptions& options,
                       const StopRequested& stop);

}  // namespace horopter
