// Frames as cameras deliver them, without a file format.
#pragma once

#include <opencv2/core/mat.hpp>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/image_codecs.h"

namespace horopter::v1 {
class RawFrame;
}

namespace horopter {

// Shape of the image that the frame becomes, after its format, sizes and stride were compared with
// its bytes. `field` names the frame. Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<ImageShape> RawFrameShape(const v1::RawFrame& frame, const std::string& field);

// Fills `image`, which has the size and type of the frame's shape: Bayer mosaics are interpolated,
// YUV is taken as BT.601 with limited range, 16 bits are scaled by those in use.
void ConvertRawFrame(const v1::RawFrame& frame, cv::Mat& image);

}  // namespace horopter
