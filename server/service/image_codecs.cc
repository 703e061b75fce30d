#include "server/service/image_codecs.h"

#include <array>

namespace horopter {

absl::StatusOr<const ImageCodec*> FindCodec(std::string_view bytes) {
  static const std::array<ImageCodec, 6> codecs = {
      JpegCodec(), PngCodec(), WebpCodec(), BmpCodec(), PnmCodec(), TiffCodec()};
  for (const ImageCodec& codec : codecs) {
    if (codec.starts(bytes)) return &codec;
  }
  return absl::InvalidArgumentError("not an image in a known format");
}

}  // namespace horopter
