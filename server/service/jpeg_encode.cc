// Images for people to look at, by libjpeg(-turbo), whose errors leave by longjmp: between setjmp
// and the last call of the library stand only plain values.
#include <csetjmp>
#include <cstdio>
#include <cstdlib>
// After <cstdio>, which it needs.
#include <jpeglib.h>

#include "server/service/image_codecs.h"

namespace horopter {
namespace {

constexpr int kQuality = 75;

struct Encoder {
  jpeg_compress_struct info;
  jpeg_error_mgr errors;
  std::jmp_buf failed;
  unsigned char* file = nullptr;
  unsigned long size = 0;  // NOLINT(google-runtime-int): the library's type
};

[[noreturn]] void OnError(j_common_ptr info) {
  std::longjmp(static_cast<Encoder*>(info->client_data)->failed, 1);
}

void NoMessage(j_common_ptr) {}

bool Encode(const cv::Mat& image, Encoder& encoder) {
  encoder.info = {};
  encoder.info.err = jpeg_std_error(&encoder.errors);
  encoder.info.client_data = &encoder;
  encoder.errors.error_exit = OnError;
  encoder.errors.output_message = NoMessage;
  if (setjmp(encoder.failed) != 0) {
    jpeg_destroy_compress(&encoder.info);
    return false;
  }
  jpeg_create_compress(&encoder.info);
  jpeg_mem_dest(&encoder.info, &encoder.file, &encoder.size);
  encoder.info.image_width = static_cast<JDIMENSION>(image.cols);
  encoder.info.image_height = static_cast<JDIMENSION>(image.rows);
  encoder.info.input_components = image.channels();
  encoder.info.in_color_space = image.channels() == 1 ? JCS_GRAYSCALE : JCS_EXT_BGR;
  jpeg_set_defaults(&encoder.info);
  jpeg_set_quality(&encoder.info, kQuality, TRUE);
  jpeg_start_compress(&encoder.info, TRUE);
  while (encoder.info.next_scanline < encoder.info.image_height) {
    // The library does not write to it.
    JSAMPROW row = const_cast<JSAMPROW>(image.ptr(static_cast<int>(encoder.info.next_scanline)));
    jpeg_write_scanlines(&encoder.info, &row, 1);
  }
  jpeg_finish_compress(&encoder.info);
  jpeg_destroy_compress(&encoder.info);
  return true;
}

}  // namespace

absl::StatusOr<std::string> EncodeJpeg(const cv::Mat& image) {
  Encoder encoder;
  const bool encoded = Encode(image, encoder);
  std::string file;
  if (encoded) file.assign(reinterpret_cast<const char*>(encoder.file), encoder.size);
  std::free(encoder.file);
  if (!encoded) return absl::ResourceExhaustedError("an image cannot be encoded as JPEG");
  return file;
}

}  // namespace horopter
