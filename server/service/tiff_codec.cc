// TIFF by libtiff: grey and colour of 16 bits by its samples, all else as the library's 8 bits.
#include <tiffio.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <opencv2/core.hpp>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

// Strips, tiles and tables of the library.
constexpr tmsize_t kMaxAllocation = tmsize_t{256} << 20;

struct MemoryFile {
  std::string_view all;
  toff_t at = 0;
};

tmsize_t Read(thandle_t handle, void* out, tmsize_t size) {
  MemoryFile& bytes = *static_cast<MemoryFile*>(handle);
  if (size < 0 || bytes.at >= bytes.all.size()) return 0;
  const size_t count = std::min(static_cast<size_t>(size), bytes.all.size() - bytes.at);
  std::memcpy(out, bytes.all.data() + bytes.at, count);
  bytes.at += count;
  return static_cast<tmsize_t>(count);
}
tmsize_t Write(thandle_t, void*, tmsize_t) {
  return 0;
}
toff_t Seek(thandle_t handle, toff_t offset, int whence) {
  MemoryFile& bytes = *static_cast<MemoryFile*>(handle);
  const toff_t from = whence == SEEK_SET ? 0 : whence == SEEK_CUR ? bytes.at : bytes.all.size();
  return bytes.at = from + offset;
}
int Close(thandle_t) {
  return 0;
}
toff_t Size(thandle_t handle) {
  return static_cast<MemoryFile*>(handle)->all.size();
}
int OnTiffMessage(TIFF*, void*, const char*, const char*, va_list) {
  return 1;  // told
}

using Tiff = std::unique_ptr<TIFF, decltype(&TIFFClose)>;

Tiff OpenTiff(MemoryFile& bytes) {
  const std::unique_ptr<TIFFOpenOptions, decltype(&TIFFOpenOptionsFree)> options(
      TIFFOpenOptionsAlloc(), TIFFOpenOptionsFree);
  TIFFOpenOptionsSetMaxSingleMemAlloc(options.get(), kMaxAllocation);
  TIFFOpenOptionsSetErrorHandlerExtR(options.get(), OnTiffMessage, nullptr);
  TIFFOpenOptionsSetWarningHandlerExtR(options.get(), OnTiffMessage, nullptr);
  return Tiff(TIFFClientOpenExt("image",
                                "rm",  // m: no memory mapping
                                &bytes,
                                Read,
                                Write,
                                Seek,
                                Close,
                                Size,
                                nullptr,
                                nullptr,
                                options.get()),
              TIFFClose);
}

absl::Status DamagedTiff() {
  return absl::InvalidArgumentError("damaged or cut-off TIFF image, or one that is not read");
}

// The tags that decide how the pixels are read.
struct Tags {
  uint32_t width = 0, height = 0;
  uint16_t bits = 1, samples = 1, format = SAMPLEFORMAT_UINT, photometric = 0, planes = 0;

  // Unsigned samples of 16 bits, of which the first one or three are the image.
  bool wide() const {
    return bits == 16 && format == SAMPLEFORMAT_UINT && channels() > 0 && samples >= channels();
  }
  int channels() const {
    if (photometric == PHOTOMETRIC_RGB) return 3;
    return photometric <= PHOTOMETRIC_MINISBLACK ? 1 : 0;
  }
};

absl::StatusOr<Tags> TagsOf(TIFF* tiff) {
  Tags tags;
  if (TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &tags.width) != 1 ||
      TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &tags.height) != 1 || tags.width < 1 ||
      tags.height < 1) {
    return DamagedTiff();
  }
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &tags.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &tags.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &tags.format);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &tags.planes);
  if (TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &tags.photometric) != 1) {
    tags.photometric = tags.samples >= 3 ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK;
  }
  return tags;
}

absl::StatusOr<ImageShape> TiffShape(TIFF* tiff) {
  HOROPTER_ASSIGN_OR_RETURN(const Tags tags, TagsOf(tiff));
  if (tags.wide()) return ImageShape{tags.width, tags.height, tags.channels(), 16};
  if (tags.format == SAMPLEFORMAT_IEEEFP)
    return absl::InvalidArgumentError("a TIFF image in floating point, which is not read");
  if (tags.bits != 1 && tags.bits != 2 && tags.bits != 4 && tags.bits != 8 && tags.bits != 16) {
    return absl::InvalidArgumentError(absl::StrCat("a TIFF image of ",
                                                   tags.bits,
                                                   " bits a sample, which is not read: 8 and 16 "
                                                   "are, also where fewer of 16 are in use"));
  }
  char message[1024];
  if (TIFFRGBAImageOK(tiff, message) == 0) return DamagedTiff();
  const bool grey = tags.samples == 1 && tags.photometric <= PHOTOMETRIC_MINISBLACK;
  return ImageShape{tags.width, tags.height, grey ? 1 : 3, 8, sizeof(uint32_t)};
}

// Copies `count` pixels of one row from x on: `in` holds `step` samples a pixel, the first of them
// that of channel `first` in the file's order, which is red, green, blue.
void CopySamples(const uint16_t* in,
                 int step,
                 int first,
                 int copied,
                 int x,
                 int count,
                 uint16_t* row,
                 int channels) {
  for (int i = 0; i < count; ++i) {
    for (int c = 0; c < copied; ++c) {
      row[channels * (x + i) + channels - 1 - (first + c)] = in[step * i + c];
    }
  }
}

// Rows of samples of 16 bits. Of separate planes each holds one channel.
bool ReadRows(TIFF* tiff, const Tags& tags, cv::Mat& image) {
  const bool separate = tags.planes == PLANARCONFIG_SEPARATE;
  const int channels = image.channels(), step = separate ? 1 : tags.samples;
  const tmsize_t row_bytes = TIFFScanlineSize(tiff);
  if (row_bytes > kMaxAllocation || row_bytes < tmsize_t{2} * step * image.cols) return false;
  std::vector<uint16_t> row(static_cast<size_t>(row_bytes / 2 + 1));
  for (int plane = 0; plane < (separate ? channels : 1); ++plane) {
    for (int y = 0; y < image.rows; ++y) {
      if (TIFFReadScanline(
              tiff, row.data(), static_cast<uint32_t>(y), static_cast<uint16_t>(plane)) != 1) {
        return false;
      }
      CopySamples(row.data(),
                  step,
                  plane,
                  separate ? 1 : channels,
                  0,
                  image.cols,
                  image.ptr<uint16_t>(y),
                  channels);
    }
  }
  return true;
}

bool ReadTiles(TIFF* tiff, const Tags& tags, cv::Mat& image) {
  const bool separate = tags.planes == PLANARCONFIG_SEPARATE;
  const int channels = image.channels(), step = separate ? 1 : tags.samples;
  uint32_t tile_width = 0, tile_height = 0;
  TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &tile_width);
  TIFFGetField(tiff, TIFFTAG_TILELENGTH, &tile_height);
  const tmsize_t size = TIFFTileSize(tiff);
  if (tile_width < 1 || tile_height < 1 || tile_width > INT32_MAX || tile_height > INT32_MAX ||
      size > kMaxAllocation || size / 2 / step / tile_width < static_cast<tmsize_t>(tile_height)) {
    return false;
  }
  const auto width = static_cast<int>(tile_width), height = static_cast<int>(tile_height);
  std::vector<uint16_t> tile(static_cast<size_t>(size / 2 + 1));
  for (int plane = 0; plane < (separate ? channels : 1); ++plane) {
    for (int64_t y = 0; y < image.rows; y += height) {
      for (int64_t x = 0; x < image.cols; x += width) {
        if (TIFFReadTile(tiff,
                         tile.data(),
                         static_cast<uint32_t>(x),
                         static_cast<uint32_t>(y),
                         0,
                         static_cast<uint16_t>(plane)) < 0) {
          return false;
        }
        const int rows = std::min<int>(height, image.rows - static_cast<int>(y));
        const int count = std::min<int>(width, image.cols - static_cast<int>(x));
        for (int r = 0; r < rows; ++r) {
          CopySamples(tile.data() + static_cast<size_t>(r) * width * step,
                      step,
                      plane,
                      separate ? 1 : channels,
                      static_cast<int>(x),
                      count,
                      image.ptr<uint16_t>(static_cast<int>(y) + r),
                      channels);
        }
      }
    }
  }
  return true;
}

absl::Status DecodeWide(TIFF* tiff, const Tags& tags, cv::Mat& image) {
  const bool read =
      TIFFIsTiled(tiff) != 0 ? ReadTiles(tiff, tags, image) : ReadRows(tiff, tags, image);
  if (!read) return DamagedTiff();
  if (tags.channels() == 1 && tags.photometric == PHOTOMETRIC_MINISWHITE)
    image = cv::Scalar((1 << BitsInUse(image)) - 1) - image;
  return absl::OkStatus();
}

absl::StatusOr<ImageShape> ReadTiffShape(std::string_view bytes) {
  MemoryFile source{bytes};
  const Tiff tiff = OpenTiff(source);
  if (tiff == nullptr) return DamagedTiff();
  return TiffShape(tiff.get());
}

absl::Status DecodeTiff(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
  MemoryFile source{bytes};
  const Tiff tiff = OpenTiff(source);
  if (tiff == nullptr) return DamagedTiff();
  HOROPTER_ASSIGN_OR_RETURN(const ImageShape shape, TiffShape(tiff.get()));
  const int bits = image.depth() == CV_16U ? 16 : 8;
  if (!(shape == ImageShape{image.cols, image.rows, image.channels(), bits})) return DamagedTiff();
  if (bits == 16) {
    HOROPTER_ASSIGN_OR_RETURN(const Tags tags, TagsOf(tiff.get()));
    return DecodeWide(tiff.get(), tags, image);
  }
  TIFFRGBAImage reader;
  char message[1024];
  if (TIFFRGBAImageBegin(&reader, tiff.get(), 1, message) == 0) return DamagedTiff();
  reader.req_orientation = reader.orientation;  // rows as they are stored
  std::vector<uint32_t> pixels(image.total());
  const int read = TIFFRGBAImageGet(&reader, pixels.data(), reader.width, reader.height);
  TIFFRGBAImageEnd(&reader);
  if (read == 0) return DamagedTiff();
  const uint32_t* in = pixels.data();
  for (int y = 0; y < image.rows; ++y) {
    unsigned char* out = image.ptr(y);
    for (int x = 0; x < image.cols; ++x, ++in, out += image.channels()) {
      out[0] = static_cast<unsigned char>(image.channels() == 1 ? TIFFGetR(*in) : TIFFGetB(*in));
      if (image.channels() == 1) continue;
      out[1] = static_cast<unsigned char>(TIFFGetG(*in));
      out[2] = static_cast<unsigned char>(TIFFGetR(*in));
    }
  }
  return absl::OkStatus();
}

}  // namespace

ImageCodec TiffCodec() {
  return {"TIFF",
          true,
          [](std::string_view bytes) {
            return bytes.substr(0, 4) == std::string_view("II*\0", 4) ||
                   bytes.substr(0, 4) == std::string_view("MM\0*", 4);
          },
          ReadTiffShape,
          DecodeTiff};
}

}  // namespace horopter
