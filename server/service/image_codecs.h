// Encoded images by the libraries that define their formats: the size a decoder works with is the
// one that was checked, and pixels are written only into memory that was made for that size.
#pragma once

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/base/stop_token.h"

namespace horopter {

// What an image is once decoded: `channels` 1 (grey) or 3 (BGR), `bits` 8 or 16 per channel.
struct ImageShape {
  int64_t width = 0;
  int64_t height = 0;
  int channels = 3;
  int bits = 8;
  int work_bytes_per_pixel = 0;  // that decoding takes beside the image

  // Of what the image is, not of the way to it.
  friend bool operator==(const ImageShape& a, const ImageShape& b) {
    return a.width == b.width && a.height == b.height && a.channels == b.channels &&
           a.bits == b.bits;
  }
};

// One format. Any bytes may be given to all three functions; none throws for what they say.
struct ImageCodec {
  const char* name = "";
  // PNM and TIFF: no camera sends them, their readers are the largest or the least tried.
  bool only_on_request = false;
  bool (*starts)(std::string_view bytes) = nullptr;
  // Reads the header alone. Errors: INVALID_ARGUMENT (damaged, cut off, a variant that is not
  // read), RESOURCE_EXHAUSTED.
  absl::StatusOr<ImageShape> (*shape)(std::string_view bytes) = nullptr;
  // Fills `image`, which has the size and type of the shape. An alpha channel is dropped, an
  // orientation tag is ignored. An end mark that is missing behind the last row is no fault.
  // Errors: as above, also when the pixels are damaged or cut off; CANCELLED.
  absl::Status (*decode)(std::string_view bytes,
                         const StopRequested& stop,
                         cv::Mat& image) = nullptr;
};

// Errors: INVALID_ARGUMENT (no format that is read; named where it is a known one).
absl::StatusOr<const ImageCodec*> FindCodec(std::string_view bytes);

// "JPEG, PNG, ..": what is read, with or without those on request.
std::string ReadFormats(bool with_those_on_request);

// Bits of 16 that the samples of an image use, told by its largest: cameras of 10, 12 and 14 bits
// leave the upper ones empty. 8, 10, 12, 14 or 16. image: 16 bits a sample, any channels.
int BitsInUse(const cv::Mat& image);

// 8 bits a sample of 16 of which `bits` are in use; larger samples are saturated.
cv::Mat ScaledTo8Bits(const cv::Mat& image, int bits);

// A PNG file of an 8-bit BGR image, compressed fast rather than well. Errors: RESOURCE_EXHAUSTED.
absl::StatusOr<std::string> EncodePng(const cv::Mat& image);

// A JPEG file for people to look at, of an 8-bit grey or BGR image. Errors: RESOURCE_EXHAUSTED.
absl::StatusOr<std::string> EncodeJpeg(const cv::Mat& image);

// The formats, one file each.
ImageCodec JpegCodec();
ImageCodec PngCodec();
ImageCodec WebpCodec();
ImageCodec HeicCodec();
ImageCodec BmpCodec();
ImageCodec PnmCodec();
ImageCodec TiffCodec();

}  // namespace horopter
