// Images of a request -> cv::Mat. First what they will take is told, then they are decoded.
#pragma once

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/service/image_codecs.h"

namespace horopter::v1 {
class RecognizeSceneRequest;
class SceneImage;
}  // namespace horopter::v1

namespace horopter {

inline constexpr int kMaxImages = 32;

struct ImageLimits {
  int min_side_px = 16;
  int64_t max_pixels = 64 << 20;           // of one image; sensors of 64 million are common
  int64_t max_total_pixels = 100'000'000;  // of all images of a request
  // Also reads TIFF and PNM, whose readers are the largest or the least tried.
  bool tiff_and_pnm = false;
};

// The shape an encoded image will have, from its header by its codec, within the limits of one
// image. `field` names the image in messages, e.g. "images[2].content". Errors: INVALID_ARGUMENT
// naming the field (empty, no known format, damaged, too small, too large).
absl::StatusOr<ImageShape> EncodedShape(std::string_view bytes,
                                        const std::string& field,
                                        const ImageLimits& limits);

// Gives CV_8UC1 or CV_8UC3 (BGR): 16 bits per channel are scaled to 8 by those of them that are in
// use, alpha is dropped, an orientation tag is ignored. Errors: as EncodedShape,
// RESOURCE_EXHAUSTED, CANCELLED.
absl::StatusOr<cv::Mat> DecodeImage(std::string_view bytes,
                                    const std::string& field,
                                    const ImageLimits& limits,
                                    const StopRequested& stop = {});

// The shapes of all images of a request, encoded or raw, within all limits. Errors:
// INVALID_ARGUMENT naming the field.
absl::StatusOr<std::vector<ImageShape>> ShapesOf(const v1::RecognizeSceneRequest& request,
                                                 const ImageLimits& limits);

// Most bytes that decoding the images takes at once, the result included.
int64_t DecodedBytes(const std::vector<ImageShape>& shapes);

// Decodes all images, `threads` at a time; an error is that of the first image that has one.
// Errors: INVALID_ARGUMENT naming the field, RESOURCE_EXHAUSTED, CANCELLED.
absl::StatusOr<std::vector<cv::Mat>> DecodeImages(const v1::RecognizeSceneRequest& request,
                                                  const ImageLimits& limits,
                                                  int threads,
                                                  const StopRequested& stop);

}  // namespace horopter
