#include "server/service/image_decode.h"

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "absl/strings/str_cat.h"
#include "server/service/image_header.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

absl::Status CheckSize(const ImageHeader& header,
                       const std::string& field,
                       const ImageLimits& limits,
                       int64_t pixels_left) {
  const std::string size = absl::StrCat(header.width, "x", header.height, " pixels");
  if (header.width < limits.min_side_px || header.height < limits.min_side_px) {
    return InvalidField(
        field, absl::StrCat(size, " is too small, need ", limits.min_side_px, " on each side"));
  }
  // Both sides are below 2^32, so that the product fits once one of them is bounded.
  if (header.width > limits.max_pixels || header.height > limits.max_pixels / header.width) {
    return InvalidField(
        field, absl::StrCat(size, " is too large, at most ", limits.max_pixels, " pixels"));
  }
  if (header.width * header.height > pixels_left) {
    return InvalidField(field,
                        absl::StrCat("with ",
                                     size,
                                     " the images of the request are too large together, at most ",
                                     limits.max_total_pixels,
                                     " pixels"));
  }
  return absl::OkStatus();
}

absl::StatusOr<cv::Mat> Decode(std::string_view bytes,
                               const std::string& field,
                               const char* format) {
  const cv::Mat encoded(
      1, static_cast<int>(bytes.size()), CV_8UC1, const_cast<char*>(bytes.data()));
  cv::Mat image;
  try {
    image = cv::imdecode(encoded,
                         cv::IMREAD_ANYCOLOR | cv::IMREAD_ANYDEPTH | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception& error) {
    return InvalidField(field, absl::StrCat("cannot be decoded as ", format, ": ", error.err));
  }
  if (image.empty()) return InvalidField(field, absl::StrCat("cannot be decoded as ", format));
  return image;
}

}  // namespace

absl::StatusOr<cv::Mat> DecodeImage(std::string_view bytes,
                                    const std::string& field,
                                    const ImageLimits& limits,
                                    int64_t& pixels_left) {
  if (bytes.empty()) return InvalidField(field, "empty");
  const absl::StatusOr<ImageHeader> header = ReadImageHeader(bytes);
  if (!header.ok()) return InvalidField(field, std::string(header.status().message()));
  if (absl::Status status = CheckSize(*header, field, limits, pixels_left); !status.ok())
    return status;

  absl::StatusOr<cv::Mat> decoded = Decode(bytes, field, header->format);
  if (!decoded.ok()) return decoded.status();
  cv::Mat image = *std::move(decoded);
  if (image.cols != header->width || image.rows != header->height) {
    return InvalidField(
        field, absl::StrCat("damaged ", header->format, " image: size differs from its header"));
  }
  if (image.channels() == 4) {
    std::vector<cv::Mat> bgr;
    cv::split(image, bgr);
    bgr.resize(3);
    cv::merge(bgr, image);
  }
  if (image.channels() != 1 && image.channels() != 3) {
    return InvalidField(field, absl::StrCat(image.channels(), " channels, need grey or colour"));
  }
  if (image.depth() == CV_16U) {
    cv::Mat scaled;
    image.convertTo(scaled, CV_8U, 1.0 / 257.0);  // 65535 -> 255
    image = scaled;
  }
  if (image.depth() != CV_8U)
    return InvalidField(field, "need 8 or 16 bits per channel, not floating point");
  pixels_left -= header->width * header->height;
  return image;
}

}  // namespace horopter
