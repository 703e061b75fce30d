// Images of known lenses, made those of a pinhole camera with square pixels.
#pragma once

#include <opencv2/core/mat.hpp>

#include "absl/status/statusor.h"
#include "server/vision/geometry/lens_model.h"

namespace horopter {

// The image as a camera of focal length lens.fx and the same principal point and size sees it. What
// the lens did not see repeats the nearest pixels. image: 8 bits a channel. Errors:
// RESOURCE_EXHAUSTED (memory).
absl::StatusOr<cv::Mat> Rectified(const cv::Mat& image, const LensModel& lens);

}  // namespace horopter
