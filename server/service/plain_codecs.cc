// BMP and PNM: rows of samples behind a short header.
#include <algorithm>
#include <cstring>
#include <optional>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

absl::Status Damaged(const char* format) {
  return absl::InvalidArgumentError(absl::StrCat("damaged or cut-off ", format, " image"));
}

std::optional<int64_t> Little(std::string_view bytes, size_t at, int size) {
  if (at > bytes.size() || bytes.size() - at < static_cast<size_t>(size)) return std::nullopt;
  uint64_t value = 0;
  for (int i = size - 1; i >= 0; --i) {
    value = value << 8 | static_cast<unsigned char>(bytes[at + i]);
  }
  return static_cast<int64_t>(value);
}

// Uncompressed BMP with a BITMAPINFOHEADER or one of its successors.
struct Bmp {
  int64_t width = 0;
  int64_t height = 0;
  bool from_top = false;
  int bits_per_pixel = 0;
  size_t pixels_at = 0;
  size_t row_bytes = 0;  // padded to four
  std::string_view palette;
  bool grey = false;  // the palette has no colour

  ImageShape shape() const { return {width, height, grey ? 1 : 3, 8}; }
};

bool IsGrey(std::string_view palette) {
  for (size_t i = 0; i + 4 <= palette.size(); i += 4) {
    if (palette[i] != palette[i + 1] || palette[i] != palette[i + 2]) return false;
  }
  return true;
}

absl::StatusOr<Bmp> ReadBmp(std::string_view bytes) {
  const auto pixels_at = Little(bytes, 10, 4), info_size = Little(bytes, 14, 4);
  const auto width = Little(bytes, 18, 4), height = Little(bytes, 22, 4);
  const auto bits = Little(bytes, 28, 2), compression = Little(bytes, 30, 4);
  const auto colours = Little(bytes, 46, 4);
  if (!colours || *info_size < 40) return Damaged("BMP");
  Bmp bmp;
  bmp.width = static_cast<int32_t>(*width);
  const int64_t signed_height = static_cast<int32_t>(*height);
  bmp.from_top = signed_height < 0;
  bmp.height = std::abs(signed_height);
  bmp.bits_per_pixel = static_cast<int>(*bits);
  bmp.pixels_at = static_cast<size_t>(*pixels_at);
  // 3: channel masks; at 32 bits all writers give those of BGRA.
  const bool plain = *compression == 0 || (*compression == 3 && *bits == 32);
  if (!plain || (*bits != 8 && *bits != 24 && *bits != 32)) {
    return absl::InvalidArgumentError("a BMP image that is compressed or not of 8, 24 or 32 bits");
  }
  if (bmp.width < 1 || bmp.height < 1) return Damaged("BMP");
  if (*bits == 8) {
    const size_t at = 14 + static_cast<size_t>(*info_size);
    const size_t size = 4 * static_cast<size_t>(*colours == 0 ? 256 : *colours);
    if (size > 4 * 256 || at > bytes.size() || bytes.size() - at < size) return Damaged("BMP");
    bmp.palette = bytes.substr(at, size);
    bmp.grey = IsGrey(bmp.palette);
  }
  bmp.row_bytes = static_cast<size_t>((bmp.width * *bits + 31) / 32 * 4);
  // The padding of the last row may be left out.
  const size_t last_row = static_cast<size_t>((bmp.width * *bits + 7) / 8);
  if (bmp.pixels_at > bytes.size() || bytes.size() - bmp.pixels_at < last_row ||
      (bytes.size() - bmp.pixels_at - last_row) / bmp.row_bytes <
          static_cast<size_t>(bmp.height - 1)) {
    return Damaged("BMP");
  }
  return bmp;
}

absl::StatusOr<ImageShape> BmpShape(std::string_view bytes) {
  HOROPTER_ASSIGN_OR_RETURN(const Bmp bmp, ReadBmp(bytes));
  return bmp.shape();
}

absl::Status DecodeBmp(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  HOROPTER_ASSIGN_OR_RETURN(const Bmp bmp, ReadBmp(bytes));
  for (int y = 0; y < image.rows; ++y) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
    const int64_t line = bmp.from_top ? y : bmp.height - 1 - y;
    const auto* in = reinterpret_cast<const unsigned char*>(bytes.data()) + bmp.pixels_at +
                     static_cast<size_t>(line) * bmp.row_bytes;
    unsigned char* out = image.ptr(y);
    for (int x = 0; x < image.cols; ++x, out += image.channels()) {
      if (bmp.bits_per_pixel != 8) {
        std::memcpy(out, in + static_cast<size_t>(x) * (bmp.bits_per_pixel / 8), 3);
      } else if (const size_t at = 4 * size_t{in[x]}; at < bmp.palette.size()) {
        std::memcpy(out, bmp.palette.data() + at, static_cast<size_t>(image.channels()));
      } else {
        return Damaged("BMP");
      }
    }
  }
  return absl::OkStatus();
}

// Binary PGM and PPM.
struct Pnm {
  ImageShape shape;
  int64_t most = 255;  // a sample is
  size_t pixels_at = 0;
};

// A number after white space and comments, which end at a line feed or a carriage return. Nothing
// for none or one above 1e9.
std::optional<int64_t> NextNumber(std::string_view bytes, size_t& at) {
  const auto is = [&](const char* chars) {
    return at < bytes.size() && bytes[at] != '\0' && std::strchr(chars, bytes[at]) != nullptr;
  };
  while (is(" \t\r\n\v\f#")) {
    if (bytes[at] == '#') {
      while (at < bytes.size() && !is("\r\n")) ++at;
    } else {
      ++at;
    }
  }
  constexpr int64_t kTooLarge = 1'000'000'000;
  std::optional<int64_t> value;
  while (is("0123456789")) {
    value = value.value_or(0) * 10 + (bytes[at++] - '0');
    if (*value > kTooLarge) return std::nullopt;
  }
  return value;
}

absl::StatusOr<Pnm> ReadPnm(std::string_view bytes) {
  size_t at = 2;
  const auto width = NextNumber(bytes, at);
  const auto height = NextNumber(bytes, at);
  const auto most = NextNumber(bytes, at);
  if (!width || !height || !most || *width < 1 || *height < 1) return Damaged("PNM");
  if (*most < 1 || *most > 65535) return Damaged("PNM");
  Pnm pnm;
  pnm.most = *most;
  pnm.shape = {*width, *height, bytes[1] == '5' ? 1 : 3, *most <= 255 ? 8 : 16};
  pnm.pixels_at = at + 1;  // one white space
  const int64_t row = *width * pnm.shape.channels * pnm.shape.bits / 8;
  if (pnm.pixels_at > bytes.size() ||
      static_cast<int64_t>(bytes.size() - pnm.pixels_at) / row < *height) {
    return Damaged("PNM");
  }
  return pnm;
}

absl::StatusOr<ImageShape> PnmShape(std::string_view bytes) {
  HOROPTER_ASSIGN_OR_RETURN(const Pnm pnm, ReadPnm(bytes));
  return pnm.shape;
}

absl::Status DecodePnm(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  HOROPTER_ASSIGN_OR_RETURN(const Pnm pnm, ReadPnm(bytes));
  const auto* in = reinterpret_cast<const unsigned char*>(bytes.data()) + pnm.pixels_at;
  const int channels = pnm.shape.channels;
  const bool wide = pnm.shape.bits == 16;
  // Samples up to another number than the whole range are stretched to it.
  const int64_t full = wide ? 65535 : 255;
  const auto stretched = [&](int64_t v) {
    return pnm.most == full ? v : (std::min(v, pnm.most) * full + pnm.most / 2) / pnm.most;
  };
  for (int y = 0; y < image.rows; ++y) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
    for (int x = 0; x < image.cols; ++x) {
      for (int c = 0; c < channels; ++c) {
        const int to = channels * x + channels - 1 - c;  // RGB to BGR
        if (!wide) {
          image.ptr(y)[to] = static_cast<unsigned char>(stretched(*in++));
        } else {
          image.ptr<uint16_t>(y)[to] = static_cast<uint16_t>(stretched(in[0] << 8 | in[1]));
          in += 2;
        }
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace

ImageCodec BmpCodec() {
  return {"BMP",
          false,
          [](std::string_view bytes) { return bytes.substr(0, 2) == "BM"; },
          BmpShape,
          DecodeBmp};
}

ImageCodec PnmCodec() {
  return {"PNM",
          true,
          [](std::string_view bytes) {
            return bytes.substr(0, 2) == "P5" || bytes.substr(0, 2) == "P6";
          },
          PnmShape,
          DecodePnm};
}

}  // namespace horopter
