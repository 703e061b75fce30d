// WebP by libwebp.
#include <webp/decode.h>

#include <algorithm>
#include <memory>

#include "server/service/image_codecs.h"

namespace horopter {
namespace {

// Fed to the decoder between two looks at the stop flag.
constexpr size_t kStep = 64 << 10;

const uint8_t* Unsigned(std::string_view bytes) {
  return reinterpret_cast<const uint8_t*>(bytes.data());
}

absl::Status DamagedWebp() {
  return absl::InvalidArgumentError("damaged or cut-off WebP image");
}

absl::StatusOr<ImageShape> ReadWebpShape(std::string_view bytes) {
  WebPBitstreamFeatures features;
  if (WebPGetFeatures(Unsigned(bytes), bytes.size(), &features) != VP8_STATUS_OK)
    return DamagedWebp();
  if (features.has_animation != 0) return absl::InvalidArgumentError("an animated WebP image");
  return ImageShape{features.width, features.height, 3, 8};
}

absl::Status DecodeWebp(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  WebPDecoderConfig config;
  if (WebPInitDecoderConfig(&config) == 0) return absl::InternalError("another libwebp");
  config.output.colorspace = MODE_BGR;
  config.output.is_external_memory = 1;
  config.output.u.RGBA.rgba = image.data;
  config.output.u.RGBA.stride = static_cast<int>(image.step);
  config.output.u.RGBA.size = image.step * static_cast<size_t>(image.rows);
  const std::unique_ptr<WebPIDecoder, decltype(&WebPIDelete)> decoder(
      WebPIDecode(nullptr, 0, &config), WebPIDelete);
  if (decoder == nullptr) return absl::ResourceExhaustedError("out of memory");
  VP8StatusCode state = VP8_STATUS_SUSPENDED;
  for (size_t fed = 0; state == VP8_STATUS_SUSPENDED && fed < bytes.size();) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
    fed = std::min(bytes.size(), fed + kStep);
    state = WebPIUpdate(decoder.get(), Unsigned(bytes), fed);
  }
  if (state == VP8_STATUS_OUT_OF_MEMORY) return absl::ResourceExhaustedError("out of memory");
  int rows = 0, width = 0, height = 0, stride = 0;
  if (state != VP8_STATUS_OK ||
      WebPIDecGetRGB(decoder.get(), &rows, &width, &height, &stride) != image.data ||
      width != image.cols || height != image.rows || rows != image.rows) {
    return DamagedWebp();
  }
  return absl::OkStatus();
}

}  // namespace

ImageCodec WebpCodec() {
  return {"WebP",
          false,
          [](std::string_view bytes) {
            return bytes.substr(0, 4) == "RIFF" && bytes.size() >= 16 &&
                   bytes.substr(8, 4) == "WEBP";
          },
          ReadWebpShape,
          DecodeWebp};
}

}  // namespace horopter
