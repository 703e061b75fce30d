// TIFF by libtiff, 8 bits per channel whatever the file has.
#include <tiffio.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <vector>

#include "server/base/status_macros.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

// Strips, tiles and tables of the library.
constexpr tmsize_t kMaxAllocation = tmsize_t{256} << 20;

struct Bytes {
  std::string_view all;
  toff_t at = 0;
};

tmsize_t Read(thandle_t handle, void* out, tmsize_t size) {
  Bytes& bytes = *static_cast<Bytes*>(handle);
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
  Bytes& bytes = *static_cast<Bytes*>(handle);
  const toff_t from = whence == SEEK_SET ? 0 : whence == SEEK_CUR ? bytes.at : bytes.all.size();
  return bytes.at = from + offset;
}
int Close(thandle_t) {
  return 0;
}
toff_t Size(thandle_t handle) {
  return static_cast<Bytes*>(handle)->all.size();
}
int OnMessage(TIFF*, void*, const char*, const char*, va_list) {
  return 1;  // told
}

using Tiff = std::unique_ptr<TIFF, decltype(&TIFFClose)>;

Tiff Open(Bytes& bytes) {
  const std::unique_ptr<TIFFOpenOptions, decltype(&TIFFOpenOptionsFree)> options(
      TIFFOpenOptionsAlloc(), TIFFOpenOptionsFree);
  TIFFOpenOptionsSetMaxSingleMemAlloc(options.get(), kMaxAllocation);
  TIFFOpenOptionsSetErrorHandlerExtR(options.get(), OnMessage, nullptr);
  TIFFOpenOptionsSetWarningHandlerExtR(options.get(), OnMessage, nullptr);
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

absl::Status Damaged() {
  return absl::InvalidArgumentError("damaged or cut-off TIFF image, or one that is not read");
}

absl::StatusOr<ImageShape> ShapeOf(TIFF* tiff) {
  uint32_t width = 0, height = 0;
  uint16_t samples = 1;
  char message[1024];
  if (TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width) != 1 ||
      TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height) != 1 ||
      TIFFRGBAImageOK(tiff, message) == 0) {
    return Damaged();
  }
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &samples);
  uint16_t photometric = 0;
  const bool grey = samples == 1 && TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &photometric) == 1 &&
                    photometric <= PHOTOMETRIC_MINISBLACK;
  return ImageShape{width, height, grey ? 1 : 3, 8};
}

absl::StatusOr<ImageShape> Shape(std::string_view bytes) {
  Bytes source{bytes};
  const Tiff tiff = Open(source);
  if (tiff == nullptr) return Damaged();
  return ShapeOf(tiff.get());
}

absl::Status Decode(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
  Bytes source{bytes};
  const Tiff tiff = Open(source);
  if (tiff == nullptr) return Damaged();
  HOROPTER_ASSIGN_OR_RETURN(const ImageShape shape, ShapeOf(tiff.get()));
  if (!(shape == ImageShape{image.cols, image.rows, image.channels(), 8})) return Damaged();
  TIFFRGBAImage reader;
  char message[1024];
  if (TIFFRGBAImageBegin(&reader, tiff.get(), 1, message) == 0) return Damaged();
  reader.req_orientation = reader.orientation;  // rows as they are stored
  std::vector<uint32_t> pixels(image.total());
  const int read = TIFFRGBAImageGet(&reader, pixels.data(), reader.width, reader.height);
  TIFFRGBAImageEnd(&reader);
  if (read == 0) return Damaged();
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
          Shape,
          Decode};
}

}  // namespace horopter
