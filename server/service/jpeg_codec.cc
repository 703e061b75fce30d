// JPEG by libjpeg(-turbo). Its errors leave by longjmp: between setjmp and the last call of the
// library stand only plain values.
#include <csetjmp>
#include <cstdio>
// After <cstdio>, which it needs.
#include <jerror.h>
#include <jpeglib.h>

#include <exception>

#include "absl/strings/str_cat.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

// A progressive file may ask for any number of passes over all pixels.
constexpr int kMaxScans = 100;

enum class Failure { kNone, kDamaged, kMemory, kStopped, kTooManyScans, kNotRead };

// All that one use of the library needs; its handlers find it by client_data.
struct Jpeg {
  jpeg_decompress_struct info;
  jpeg_error_mgr errors;
  jpeg_progress_mgr progress;
  std::jmp_buf failed;
  Failure failure = Failure::kNone;
  const StopRequested* stop = nullptr;
  bool no_end_mark = false;   // the library ran out of bytes and went on as if there were one
  std::exception_ptr thrown;  // by `stop`; must not pass through the library
};

Jpeg& Owner(j_common_ptr info) {
  return *static_cast<Jpeg*>(info->client_data);
}

[[noreturn]] void Leave(Jpeg& jpeg, Failure failure) {
  jpeg.failure = failure;
  std::longjmp(jpeg.failed, 1);
}

void OnJpegError(j_common_ptr info) {
  switch (info->err->msg_code) {
    case JERR_OUT_OF_MEMORY:
      Leave(Owner(info), Failure::kMemory);
    case JERR_BAD_PRECISION:
    case JERR_SOF_UNSUPPORTED:
      Leave(Owner(info), Failure::kNotRead);
    default:
      Leave(Owner(info), Failure::kDamaged);
  }
}

// Warnings after which pixels are made up: the data end early, or make no sense. Others, such as
// bytes too many before a marker, come from many cameras and do no harm. The end of all bytes is
// none yet: where it comes too early for a pixel, another follows (see IsWhole for those that do
// not say so).
void OnJpegMessage(j_common_ptr info, int level) {
  if (level >= 0) return;
  switch (info->err->msg_code) {
    case JWRN_JPEG_EOF:
      Owner(info).no_end_mark = true;
      return;
    case JWRN_HIT_MARKER:
    case JWRN_HUFF_BAD_CODE:
    case JWRN_BOGUS_PROGRESSION:
    case JWRN_MUST_RESYNC:
      Leave(Owner(info), Failure::kDamaged);
    default:
      return;
  }
}

void OnProgress(j_common_ptr info) {
  Jpeg& jpeg = Owner(info);
  bool stopped = false;
  try {
    stopped = jpeg.stop != nullptr && IsStopRequested(*jpeg.stop);
  } catch (...) {
    jpeg.thrown = std::current_exception();
  }
  if (stopped || jpeg.thrown != nullptr) Leave(jpeg, Failure::kStopped);
  if (jpeg.info.input_scan_number > kMaxScans) Leave(jpeg, Failure::kTooManyScans);
}

void NoOutput(j_common_ptr) {}

// jpeg.failed must be set.
void ReadJpegHeader(Jpeg& jpeg, std::string_view bytes) {
  jpeg_create_decompress(&jpeg.info);
  jpeg_mem_src(&jpeg.info, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
  jpeg_read_header(&jpeg.info, TRUE);
}

void Prepare(Jpeg& jpeg) {
  jpeg.info.err = jpeg_std_error(&jpeg.errors);
  jpeg.info.client_data = &jpeg;
  jpeg.errors.error_exit = OnJpegError;
  jpeg.errors.emit_message = OnJpegMessage;
  jpeg.errors.output_message = NoOutput;
}

ImageShape JpegShape(const Jpeg& jpeg) {
  return {jpeg.info.image_width, jpeg.info.image_height, jpeg.info.num_components, 8};
}

absl::Status JpegStatusOf(Failure failure) {
  switch (failure) {
    case Failure::kNone:
      return absl::OkStatus();
    case Failure::kDamaged:
      return absl::InvalidArgumentError("damaged or cut-off JPEG image");
    case Failure::kNotRead:
      return absl::InvalidArgumentError(
          "a JPEG image of more than 8 bits, lossless or JPEG-LS, which is not read");
    case Failure::kTooManyScans:
      return absl::InvalidArgumentError(
          absl::StrCat("JPEG image with more than ", kMaxScans, " scans"));
    case Failure::kMemory:
      return absl::ResourceExhaustedError("out of memory");
    case Failure::kStopped:
      return absl::CancelledError("stopped while decoding images");
  }
  return absl::OkStatus();
}

// Runs `steps(jpeg)` with the handlers set; frees what the library holds.
template <typename Steps>
Failure Run(Jpeg& jpeg, const Steps& steps) {
  jpeg.info = {};
  Prepare(jpeg);
  if (setjmp(jpeg.failed) == 0) steps(jpeg);
  jpeg_destroy_decompress(&jpeg.info);
  if (jpeg.thrown != nullptr) std::rethrow_exception(jpeg.thrown);
  return jpeg.failure;
}

// Whether a file that ended before its last row was out had all that it was to have: scans that are
// not there at all leave no warning, and arithmetic coding goes on for ever with what it takes for
// zeros.
bool IsWhole(const jpeg_decompress_struct& info) {
  if (info.arith_code) return false;
  for (int c = 0; c < info.num_components; ++c) {
    if (info.comp_info[c].quant_table == nullptr) return false;  // no scan had this component
    if (!info.progressive_mode) continue;
    if (info.coef_bits == nullptr) return false;
    for (int k = 0; k < DCTSIZE2; ++k) {
      if (info.coef_bits[c][k] != 0) return false;  // not known, or not to the last bit
    }
  }
  return true;
}

absl::StatusOr<ImageShape> ReadJpegShape(std::string_view bytes) {
  Jpeg jpeg;
  ImageShape shape;
  const Failure failure = Run(jpeg, [&](Jpeg& j) {
    ReadJpegHeader(j, bytes);
    shape = JpegShape(j);
  });
  if (failure != Failure::kNone) return JpegStatusOf(failure);
  if (shape.channels != 1 && shape.channels != 3) {
    return absl::InvalidArgumentError(
        absl::StrCat(shape.channels, " channels, need grey or colour"));
  }
  return shape;
}

absl::Status DecodeJpeg(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  Jpeg jpeg;
  jpeg.stop = &stop;
  return JpegStatusOf(Run(jpeg, [&](Jpeg& j) {
    ReadJpegHeader(j, bytes);
    if (!(JpegShape(j) == ImageShape{image.cols, image.rows, image.channels(), 8})) {
      Leave(j, Failure::kDamaged);
    }
    j.progress.progress_monitor = OnProgress;
    j.info.progress = &j.progress;
    j.info.out_color_space = image.channels() == 1 ? JCS_GRAYSCALE : JCS_EXT_BGR;
    jpeg_start_decompress(&j.info);
    while (j.info.output_scanline < j.info.output_height) {
      JSAMPROW row = image.ptr(static_cast<int>(j.info.output_scanline));
      jpeg_read_scanlines(&j.info, &row, 1);
    }
    if (j.no_end_mark && !IsWhole(j.info)) Leave(j, Failure::kDamaged);
    jpeg_finish_decompress(&j.info);
  }));
}

}  // namespace

ImageCodec JpegCodec() {
  return {"JPEG",
          false,
          [](std::string_view bytes) { return bytes.substr(0, 3) == "\xff\xd8\xff"; },
          ReadJpegShape,
          DecodeJpeg};
}

}  // namespace horopter
