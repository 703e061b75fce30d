// Encoded image -> cv::Mat, with limits checked before memory is spent.
#pragma once

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace horopter {

struct ImageLimits {
  int min_side_px = 16;
  int64_t max_pixels = 50'000'000;         // of one image
  int64_t max_total_pixels = 200'000'000;  // of all images of a request
};

// Gives CV_8UC1 or CV_8UC3 (BGR): 16 bits per channel are scaled to 8, alpha is dropped, an
// orientation tag is ignored. `field` names the image in messages, e.g. "images[2].content".
// `pixels_left` is lowered by the image's pixels. Errors: INVALID_ARGUMENT (empty, no known format,
// damaged, too small, too large, floating point).
absl::StatusOr<cv::Mat> DecodeImage(std::string_view bytes,
                                    const std::string& field,
                                    const ImageLimits& limits,
                                    int64_t& pixels_left);

}  // namespace horopter
