#include "server/service/raw_frame.h"

#include <opencv2/imgproc.hpp>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

using Format = v1::RawFrame;

// How a format is stored, and what makes it BGR.
struct Layout {
  int bytes_per_pixel = 0;  // of a row; 0: no known format
  int type = CV_8UC1;       // as OpenCV sees a row
  bool half_rows = false;   // half as many rows of colour below those of brightness
  bool even_width = false, even_height = false;
  int conversion = kNone;

  static constexpr int kNone = -1;
  bool wide() const { return CV_MAT_DEPTH(type) == CV_16U; }
};

Layout Bayer(int type, int conversion) {
  return {CV_ELEM_SIZE(type), type, false, true, true, conversion};
}

// OpenCV names a mosaic by its second row and column: red first is its "BG".
Layout LayoutOf(Format::PixelFormat format) {
  switch (format) {
    case Format::PIXEL_FORMAT_GRAY8:
      return {1, CV_8UC1};
    case Format::PIXEL_FORMAT_GRAY16:
      return {2, CV_16UC1};
    case Format::PIXEL_FORMAT_BGR8:
      return {3, CV_8UC3};
    case Format::PIXEL_FORMAT_RGB8:
      return {3, CV_8UC3, false, false, false, cv::COLOR_RGB2BGR};
    case Format::PIXEL_FORMAT_BAYER_RG8:
      return Bayer(CV_8UC1, cv::COLOR_BayerBG2BGR);
    case Format::PIXEL_FORMAT_BAYER_BG8:
      return Bayer(CV_8UC1, cv::COLOR_BayerRG2BGR);
    case Format::PIXEL_FORMAT_BAYER_GB8:
      return Bayer(CV_8UC1, cv::COLOR_BayerGR2BGR);
    case Format::PIXEL_FORMAT_BAYER_GR8:
      return Bayer(CV_8UC1, cv::COLOR_BayerGB2BGR);
    case Format::PIXEL_FORMAT_BAYER_RG16:
      return Bayer(CV_16UC1, cv::COLOR_BayerBG2BGR);
    case Format::PIXEL_FORMAT_BAYER_BG16:
      return Bayer(CV_16UC1, cv::COLOR_BayerRG2BGR);
    case Format::PIXEL_FORMAT_BAYER_GB16:
      return Bayer(CV_16UC1, cv::COLOR_BayerGR2BGR);
    case Format::PIXEL_FORMAT_BAYER_GR16:
      return Bayer(CV_16UC1, cv::COLOR_BayerGB2BGR);
    case Format::PIXEL_FORMAT_NV12:
      return {1, CV_8UC1, true, true, true, cv::COLOR_YUV2BGR_NV12};
    case Format::PIXEL_FORMAT_NV21:
      return {1, CV_8UC1, true, true, true, cv::COLOR_YUV2BGR_NV21};
    case Format::PIXEL_FORMAT_UYVY:
      return {2, CV_8UC2, false, true, false, cv::COLOR_YUV2BGR_UYVY};
    case Format::PIXEL_FORMAT_YUYV:
      return {2, CV_8UC2, false, true, false, cv::COLOR_YUV2BGR_YUYV};
    default:
      return {};
  }
}

int64_t Rows(const v1::RawFrame& frame, const Layout& layout) {
  const int64_t height = frame.height_px();
  return layout.half_rows ? height + height / 2 : height;
}

int64_t Stride(const v1::RawFrame& frame, const Layout& layout) {
  return frame.stride_bytes() != 0 ? frame.stride_bytes()
                                   : int64_t{layout.bytes_per_pixel} * frame.width_px();
}

absl::Status CheckBits(const v1::RawFrame& frame, const Layout& layout, const std::string& field) {
  const int bits = frame.bits_in_use();
  if (bits == 0) return absl::OkStatus();
  if (!layout.wide()) return InvalidField(field, "only of formats of 16 bits");
  if (bits < 8 || bits > 16) return InvalidField(field, absl::StrCat(bits, ", must be 8 to 16"));
  return absl::OkStatus();
}

absl::Status CheckBytes(const v1::RawFrame& frame, const Layout& layout, const std::string& field) {
  const int64_t row = int64_t{layout.bytes_per_pixel} * frame.width_px();
  const int64_t stride = Stride(frame, layout), rows = Rows(frame, layout);
  if (stride < row) {
    return InvalidField(field + ".stride_bytes",
                        absl::StrCat(stride, " bytes, but a row has ", row, " bytes of pixels"));
  }
  // The padding of the last row may be left out.
  const int64_t needed = stride * (rows - 1) + row;
  const auto given = static_cast<int64_t>(frame.data().size());
  if (given < needed || given > stride * rows) {
    return InvalidField(field + ".data", absl::StrCat(given, " bytes, need ", stride * rows));
  }
  return absl::OkStatus();
}

// The lower byte comes first, whatever machine this is; rows may begin at odd bytes.
cv::Mat WideSamples(const v1::RawFrame& frame, const Layout& layout) {
  cv::Mat samples(frame.height_px(), frame.width_px(), CV_16UC1);
  const auto stride = static_cast<size_t>(Stride(frame, layout));
  for (int y = 0; y < samples.rows; ++y) {
    const auto* in = reinterpret_cast<const unsigned char*>(frame.data().data()) +
                     static_cast<size_t>(y) * stride;
    uint16_t* out = samples.ptr<uint16_t>(y);
    for (int x = 0; x < samples.cols; ++x, in += 2)
      out[x] = static_cast<uint16_t>(in[0] | in[1] << 8);
  }
  return samples;
}

}  // namespace

absl::StatusOr<ImageShape> RawFrameShape(const v1::RawFrame& frame, const std::string& field) {
  if (frame.width_px() < 1) return InvalidField(field + ".width_px", "must be positive");
  if (frame.height_px() < 1) return InvalidField(field + ".height_px", "must be positive");
  const Layout layout = LayoutOf(frame.format());
  if (layout.bytes_per_pixel == 0) return InvalidField(field + ".format", "unset or unknown");
  if ((layout.even_width && frame.width_px() % 2 != 0) ||
      (layout.even_height && frame.height_px() % 2 != 0)) {
    return InvalidField(
        field + ".format",
        layout.even_height ? "width and height must be even" : "the width must be even");
  }
  if (const absl::Status bits = CheckBits(frame, layout, field + ".bits_in_use"); !bits.ok())
    return bits;
  if (const absl::Status bytes = CheckBytes(frame, layout, field); !bytes.ok()) return bytes;
  const bool grey = layout.conversion == Layout::kNone && CV_MAT_CN(layout.type) == 1;
  ImageShape shape{frame.width_px(), frame.height_px(), grey ? 1 : 3, 8};
  if (layout.wide()) shape.work_bytes_per_pixel = 3;  // samples of 16 and of 8 bits
  return shape;
}

void ConvertRawFrame(const v1::RawFrame& frame, cv::Mat& image) {
  const Layout layout = LayoutOf(frame.format());
  cv::Mat stored;
  if (layout.wide()) {
    const cv::Mat samples = WideSamples(frame, layout);
    stored =
        ScaledTo8Bits(samples, frame.bits_in_use() != 0 ? frame.bits_in_use() : BitsInUse(samples));
  } else {
    stored = cv::Mat(static_cast<int>(Rows(frame, layout)),
                     frame.width_px(),
                     layout.type,
                     const_cast<char*>(frame.data().data()),
                     static_cast<size_t>(Stride(frame, layout)));
  }
  if (layout.conversion == Layout::kNone) {
    stored.copyTo(image);
  } else {
    cv::cvtColor(stored, image, layout.conversion);
  }
}

}  // namespace horopter
