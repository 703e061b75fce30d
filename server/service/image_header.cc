#include "server/service/image_header.h"

#include <algorithm>
#include <cctype>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

// Reads integers at any position; outside the bytes it gives nothing.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  std::optional<int64_t> Big(size_t at, int size) const { return Read(at, size, true); }
  std::optional<int64_t> Little(size_t at, int size) const { return Read(at, size, false); }
  std::optional<int64_t> Read(size_t at, int size, bool big_endian) const {
    if (at > bytes_.size() || bytes_.size() - at < static_cast<size_t>(size)) return std::nullopt;
    uint64_t value = 0;
    for (int i = 0; i < size; ++i) {
      const int k = big_endian ? i : size - 1 - i;
      value = value << 8 | static_cast<unsigned char>(bytes_[at + k]);
    }
    return static_cast<int64_t>(value);
  }

 private:
  std::string_view bytes_;
};

using MaybeHeader = std::optional<ImageHeader>;

MaybeHeader Make(const char* format, std::optional<int64_t> width, std::optional<int64_t> height) {
  if (!width || !height) return std::nullopt;
  return ImageHeader{format, *width, *height};
}

// Markers up to the frame header (ITU T.81, B.1 and B.2.2), then the end-of-image marker somewhere
// after the scan begins: decoders fill a cut-off scan with grey and report success.
MaybeHeader ReadJpeg(std::string_view bytes) {
  const ByteReader reader(bytes);
  MaybeHeader header;
  size_t at = 2;
  while (true) {
    const auto marker = reader.Big(at, 2);
    if (!marker || (*marker >> 8) != 0xff) return std::nullopt;
    const int code = static_cast<int>(*marker & 0xff);
    if (code == 0xff) {  // fill byte
      ++at;
      continue;
    }
    const auto length = reader.Big(at + 2, 2);
    if (!length || *length < 2) return std::nullopt;
    const bool frame = code >= 0xc0 && code <= 0xcf && code != 0xc4 && code != 0xc8 && code != 0xcc;
    if (frame) header = Make("jpeg", reader.Big(at + 7, 2), reader.Big(at + 5, 2));
    at += 2 + static_cast<size_t>(*length);
    if (code == 0xda) break;
  }
  if (at >= bytes.size() || bytes.find("\xff\xd9", at) == std::string_view::npos)
    return std::nullopt;
  return header;
}

// Tags 256 and 257 of the first directory (TIFF 6.0, section 2).
MaybeHeader ReadTiff(std::string_view bytes) {
  const ByteReader reader(bytes);
  const bool big = bytes[0] == 'M';
  const auto directory = reader.Read(4, 4, big);
  if (!directory) return std::nullopt;
  const auto count = reader.Read(static_cast<size_t>(*directory), 2, big);
  if (!count) return std::nullopt;
  std::optional<int64_t> size[2];
  for (int64_t i = 0; i < *count; ++i) {
    const size_t entry = static_cast<size_t>(*directory) + 2 + 12 * static_cast<size_t>(i);
    const auto tag = reader.Read(entry, 2, big);
    const auto type = reader.Read(entry + 2, 2, big);
    if (!tag || !type) return std::nullopt;
    constexpr int kShort = 3;
    if (*tag == 256 || *tag == 257)
      size[*tag - 256] = reader.Read(entry + 8, *type == kShort ? 2 : 4, big);
  }
  return Make("tiff", size[0], size[1]);
}

// Width and height are the two numbers after the magic; '#' begins a comment up to the end of the
// line.
MaybeHeader ReadPnm(std::string_view bytes) {
  size_t at = 2;
  std::optional<int64_t> size[2];
  for (auto& value : size) {
    while (at < bytes.size() &&
           (std::isspace(static_cast<unsigned char>(bytes[at])) || bytes[at] == '#')) {
      if (bytes[at] == '#') {
        while (at < bytes.size() && bytes[at] != '\n') ++at;
      } else {
        ++at;
      }
    }
    constexpr int64_t kTooLarge = 1'000'000'000;
    while (at < bytes.size() && std::isdigit(static_cast<unsigned char>(bytes[at]))) {
      value = std::min(value.value_or(0) * 10 + (bytes[at++] - '0'), kTooLarge);
    }
  }
  return Make("pnm", size[0], size[1]);
}

// RFC 9649, 2.5 to 2.7.
MaybeHeader ReadWebp(std::string_view bytes) {
  const ByteReader reader(bytes);
  const std::string_view chunk = bytes.substr(12, 4);
  if (chunk == "VP8X") {
    const auto width = reader.Little(24, 3), height = reader.Little(27, 3);
    if (!width || !height) return std::nullopt;
    return ImageHeader{"webp", *width + 1, *height + 1};
  }
  if (chunk == "VP8L") {
    const auto bits = reader.Little(21, 4);
    if (!bits) return std::nullopt;
    return ImageHeader{"webp", (*bits & 0x3fff) + 1, (*bits >> 14 & 0x3fff) + 1};
  }
  const auto width = reader.Little(26, 2), height = reader.Little(28, 2);
  if (chunk != "VP8 " || !width || !height) return std::nullopt;
  return ImageHeader{"webp", *width & 0x3fff, *height & 0x3fff};
}

MaybeHeader ReadBmp(std::string_view bytes) {
  const ByteReader reader(bytes);
  const auto info_size = reader.Little(14, 4);
  if (!info_size) return std::nullopt;
  if (*info_size == 12) return Make("bmp", reader.Little(18, 2), reader.Little(20, 2));
  const auto width = reader.Little(18, 4), height = reader.Little(22, 4);
  if (!width || !height) return std::nullopt;
  const int64_t signed_height = static_cast<int32_t>(*height);  // negative: rows from top to bottom
  return ImageHeader{
      "bmp", static_cast<int32_t>(*width), signed_height < 0 ? -signed_height : signed_height};
}

}  // namespace

absl::StatusOr<ImageHeader> ReadImageHeader(std::string_view bytes) {
  const auto starts = [&](std::string_view magic) {
    return bytes.substr(0, magic.size()) == magic;
  };
  const ByteReader reader(bytes);
  const char* format = nullptr;
  MaybeHeader header;
  if (starts("\x89PNG\r\n\x1a\n")) {
    format = "PNG";
    if (bytes.size() >= 24 && bytes.substr(12, 4) == "IHDR")
      header = Make("png", reader.Big(16, 4), reader.Big(20, 4));
  } else if (starts("\xff\xd8\xff")) {
    format = "JPEG";
    header = ReadJpeg(bytes);
  } else if (starts("BM")) {
    format = "BMP";
    header = ReadBmp(bytes);
  } else if (starts(std::string_view("II*\0", 4)) || starts(std::string_view("MM\0*", 4))) {
    format = "TIFF";
    header = ReadTiff(bytes);
  } else if (starts("RIFF") && bytes.size() >= 16 && bytes.substr(8, 4) == "WEBP") {
    format = "WebP";
    header = ReadWebp(bytes);
  } else if (bytes.size() > 2 && bytes[0] == 'P' && bytes[1] >= '1' && bytes[1] <= '6') {
    format = "PNM";
    header = ReadPnm(bytes);
  }
  if (format == nullptr) return absl::InvalidArgumentError("not an image in a known format");
  if (!header)
    return absl::InvalidArgumentError(absl::StrCat("damaged or cut-off ", format, " image"));
  return *header;
}

}  // namespace horopter
