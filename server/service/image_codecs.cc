#include "server/service/image_codecs.h"

#include <algorithm>
#include <array>
#include <bit>
#include <opencv2/core.hpp>

#include "absl/strings/str_cat.h"
#include "server/service/image_formats.h"

namespace horopter {
namespace {

const std::array<ImageCodec, 7>& Codecs() {
  static const std::array<ImageCodec, 7> codecs = {
      JpegCodec(), PngCodec(), WebpCodec(), BmpCodec(), HeicCodec(), PnmCodec(), TiffCodec()};
  return codecs;
}

}  // namespace

absl::StatusOr<const ImageCodec*> FindCodec(std::string_view bytes) {
  const std::string other = NameOfOtherFormat(bytes);
  if (!other.empty()) return absl::InvalidArgumentError(absl::StrCat(other, ", which is not read"));
  for (const ImageCodec& codec : Codecs()) {
    if (codec.starts(bytes)) return &codec;
  }
  return absl::InvalidArgumentError("not an image in a known format");
}

std::string ReadFormats(bool with_those_on_request) {
  std::string names;
  for (const ImageCodec& codec : Codecs()) {
    if (codec.only_on_request && !with_those_on_request) continue;
    absl::StrAppend(&names, names.empty() ? "" : ", ", codec.name);
  }
  return names;
}

int BitsInUse(const cv::Mat& image) {
  double largest = 0.0;
  cv::minMaxIdx(image.reshape(1), nullptr, &largest);
  const int bits = std::bit_width(static_cast<unsigned>(largest));
  return std::max(8, bits + bits % 2);
}

cv::Mat ScaledTo8Bits(const cv::Mat& image, int bits) {
  cv::Mat scaled;
  image.convertTo(scaled, CV_8U, 255.0 / ((1 << bits) - 1));
  return scaled;
}

}  // namespace horopter
