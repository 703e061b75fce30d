#include "server/service/raw_frame.h"

#include <opencv2/imgproc.hpp>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

// Bytes of one row without padding; 0: no known format.
int64_t RowBytes(v1::RawFrame::PixelFormat format, int64_t width) {
  switch (format) {
    case v1::RawFrame::PIXEL_FORMAT_GRAY8:
    case v1::RawFrame::PIXEL_FORMAT_BAYER_RG8:
    case v1::RawFrame::PIXEL_FORMAT_NV12:
      return width;
    case v1::RawFrame::PIXEL_FORMAT_BGR8:
    case v1::RawFrame::PIXEL_FORMAT_RGB8:
      return 3 * width;
    default:
      return 0;
  }
}

// Stored rows: NV12 has half as many of colour below those of brightness.
int64_t Rows(const v1::RawFrame& frame) {
  const int64_t height = frame.height_px();
  return frame.format() == v1::RawFrame::PIXEL_FORMAT_NV12 ? height + height / 2 : height;
}

int64_t Stride(const v1::RawFrame& frame) {
  return frame.stride_bytes() != 0 ? frame.stride_bytes()
                                   : RowBytes(frame.format(), frame.width_px());
}

}  // namespace

absl::StatusOr<ImageShape> RawFrameShape(const v1::RawFrame& frame, const std::string& field) {
  if (frame.width_px() < 1) return InvalidField(field + ".width_px", "must be positive");
  if (frame.height_px() < 1) return InvalidField(field + ".height_px", "must be positive");
  const int64_t row = RowBytes(frame.format(), frame.width_px());
  if (row == 0) return InvalidField(field + ".format", "unset or unknown");
  const bool blocks_of_two = frame.format() == v1::RawFrame::PIXEL_FORMAT_NV12 ||
                             frame.format() == v1::RawFrame::PIXEL_FORMAT_BAYER_RG8;
  if (blocks_of_two && (frame.width_px() % 2 != 0 || frame.height_px() % 2 != 0)) {
    return InvalidField(field + ".format", "width and height must be even");
  }
  if (frame.stride_bytes() != 0 && frame.stride_bytes() < row) {
    return InvalidField(
        field + ".stride_bytes",
        absl::StrCat(frame.stride_bytes(), " bytes, but a row has ", row, " bytes of pixels"));
  }
  // The padding of the last row may be left out.
  const int64_t needed = Stride(frame) * (Rows(frame) - 1) + row;
  const auto given = static_cast<int64_t>(frame.data().size());
  if (given < needed || given > Stride(frame) * Rows(frame)) {
    return InvalidField(field + ".data",
                        absl::StrCat(given, " bytes, need ", Stride(frame) * Rows(frame)));
  }
  const bool grey = frame.format() == v1::RawFrame::PIXEL_FORMAT_GRAY8;
  return ImageShape{frame.width_px(), frame.height_px(), grey ? 1 : 3, 8};
}

void ConvertRawFrame(const v1::RawFrame& frame, cv::Mat& image) {
  const auto format = frame.format();
  const bool three =
      format == v1::RawFrame::PIXEL_FORMAT_BGR8 || format == v1::RawFrame::PIXEL_FORMAT_RGB8;
  const cv::Mat stored(static_cast<int>(Rows(frame)),
                       frame.width_px(),
                       three ? CV_8UC3 : CV_8UC1,
                       const_cast<char*>(frame.data().data()),
                       static_cast<size_t>(Stride(frame)));
  switch (format) {
    case v1::RawFrame::PIXEL_FORMAT_RGB8:
      cv::cvtColor(stored, image, cv::COLOR_RGB2BGR);
      return;
    case v1::RawFrame::PIXEL_FORMAT_BAYER_RG8:
      // OpenCV names the mosaic by its second row and column: red first is its "BG".
      cv::cvtColor(stored, image, cv::COLOR_BayerBG2BGR);
      return;
    case v1::RawFrame::PIXEL_FORMAT_NV12:
      cv::cvtColor(stored, image, cv::COLOR_YUV2BGR_NV12);
      return;
    default:
      stored.copyTo(image);
  }
}

}  // namespace horopter
