// Format and size of an encoded image from its first bytes, before anything is decoded.
#pragma once

#include <cstdint>
#include <string_view>

#include "absl/status/statusor.h"

namespace horopter {

struct ImageHeader {
  const char* format = "";  // png, jpeg, bmp, tiff, pnm, webp
  int64_t width = 0;
  int64_t height = 0;
};

// Reads PNG, JPEG, BMP, TIFF, PBM/PGM/PPM and WebP. Any bytes may be given.
// Errors: INVALID_ARGUMENT (no such format, header damaged; a JPEG without its end marker is cut
// off).
absl::StatusOr<ImageHeader> ReadImageHeader(std::string_view bytes);

}  // namespace horopter
