// Images larger than the stages gain from, as telephones take them, are made smaller for them; the
// answer is told in the pixels of the images as they came.
#pragma once

#include <opencv2/core/types.hpp>
#include <vector>

#include "server/pipeline/scene.h"

namespace horopter {

// By how much an image is made smaller, at least `least_side_px` of its larger side stay; 1: not at
// all. least_side_px 0: never.
int ReductionOf(cv::Size image, int least_side_px);

// The request with its images averaged over squares of `factors` pixels a side (the right and lower
// border that fills none is cut off) and its hints in the pixels of these. One factor per image.
SceneRequest ReducedRequest(const SceneRequest& request, const std::vector<int>& factors);

// What a reduced request was answered, in pixels of the images as they came.
void TellInOriginalPixels(const SceneRequest& original,
                          const std::vector<int>& factors,
                          SceneAnswer* answer);

}  // namespace horopter
