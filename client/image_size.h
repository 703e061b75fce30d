// Sizes of images as the server will see them.
#pragma once

#include <opencv2/core/types.hpp>
#include <string>

#include "absl/status/statusor.h"

namespace horopter {

// Of the file's bytes: of an image's own pixels, whatever its orientation tag says; of HEIC, whose
// turns belong to the image, after them. Errors: INVALID_ARGUMENT (cannot be decoded).
absl::StatusOr<cv::Size> EncodedImageSize(const std::string& bytes);

}  // namespace horopter
