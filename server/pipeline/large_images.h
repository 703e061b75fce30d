// Images larger than the stages gain from, as telephones take them, are made smaller for them, and
// small ones larger; the answer is told in the pixels of the images as they came.
#pragma once

#include <opencv2/core/types.hpp>
#include <vector>

#include "server/pipeline/scene.h"

namespace horopter {

// By how much an image is made smaller, at least `least_side_px` of its larger side stay, 0: never;
// 1: not at all. 0.5: it is made twice as large, as its larger side is shorter than
// `small_side_px`, and two thirds of that at least: smaller ones the aspects enlarge by more.
double ReductionOf(cv::Size image, int least_side_px, int small_side_px = 0);

// The request with its images averaged over squares of `factors` pixels a side (the right and lower
// border that fills none is cut off), those of less than one interpolated, and its hints in the
// pixels of these. One factor per image.
SceneRequest ReducedRequest(const SceneRequest& request, const std::vector<double>& factors);

// What a reduced request was answered, in pixels of the images as they came.
void TellInOriginalPixels(const SceneRequest& original,
                          const std::vector<double>& factors,
                          SceneAnswer* answer);

}  // namespace horopter
