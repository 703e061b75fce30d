// Small pictures of a request's images, for people.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "server/service/image_decode.h"

namespace horopter {

struct ImagePreview {
  std::string jpeg;  // at most 800 pixels on the longer side
  int image_width = 0;
  int image_height = 0;
};

// Errors: as DecodeImages.
absl::StatusOr<ImagePreview> MakePreview(const v1::SceneImage& image, const ImageLimits& limits);

}  // namespace horopter
