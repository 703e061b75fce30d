// PNG by libpng. Its errors leave by longjmp: between setjmp and the last call of the library stand
// only plain values.
#include <png.h>

#include <algorithm>
#include <csetjmp>
#include <cstring>
#include <exception>
#include <vector>

#include "server/service/image_codecs.h"

namespace horopter {
namespace {

constexpr std::string_view kSignature = "\x89PNG\r\n\x1a\n";
// Texts and colour profiles are read over; a chunk that unfolds to more than this is refused.
constexpr png_alloc_size_t kMaxChunkBytes = 1 << 20;
constexpr png_uint_32 kMaxChunks = 100;
// Above what ImageLimits may allow on one side; both sides below it keep products in 64 bits.
constexpr png_uint_32 kMaxSide = 1u << 30;

struct Png {
  png_structp reader = nullptr;
  png_infop info = nullptr;
  std::string_view left;
  const StopRequested* stop = nullptr;
  bool stopped = false;
  std::exception_ptr thrown;  // by `stop`; must not pass through the library

  ~Png() { png_destroy_read_struct(&reader, &info, nullptr); }
};

void OnError(png_structp reader, png_const_charp) {
  png_longjmp(reader, 1);
}
void OnWarning(png_structp, png_const_charp) {}

void OnRead(png_structp reader, png_bytep out, size_t size) {
  Png& png = *static_cast<Png*>(png_get_io_ptr(reader));
  if (size > png.left.size()) png_error(reader, "cut off");
  std::memcpy(out, png.left.data(), size);
  png.left.remove_prefix(size);
}

void OnRow(png_structp reader, png_uint_32, int) {
  Png& png = *static_cast<Png*>(png_get_io_ptr(reader));
  try {
    png.stopped = png.stop != nullptr && IsStopRequested(*png.stop);
  } catch (...) {
    png.thrown = std::current_exception();
  }
  if (png.stopped || png.thrown != nullptr) png_error(reader, "stopped");
}

bool Create(Png& png, std::string_view bytes) {
  png.left = bytes;
  png.reader = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, OnError, OnWarning);
  if (png.reader != nullptr) png.info = png_create_info_struct(png.reader);
  return png.info != nullptr;
}

// Up to the first row, with the transformations to grey or BGR set.
void ReadHeader(Png& png) {
  png_set_read_fn(png.reader, &png, OnRead);
  png_set_user_limits(png.reader, kMaxSide, kMaxSide);
  png_set_chunk_malloc_max(png.reader, kMaxChunkBytes);
  png_set_chunk_cache_max(png.reader, kMaxChunks);
  png_read_info(png.reader, png.info);
  png_set_expand(png.reader);  // palettes to colours, fewer than 8 bits to 8
  png_set_strip_alpha(png.reader);
  png_set_bgr(png.reader);
  png_set_swap(png.reader);
}

ImageShape ShapeOf(const Png& png) {
  const bool colour = (png_get_color_type(png.reader, png.info) & PNG_COLOR_MASK_COLOR) != 0;
  return {png_get_image_width(png.reader, png.info),
          png_get_image_height(png.reader, png.info),
          colour ? 3 : 1,
          png_get_bit_depth(png.reader, png.info) == 16 ? 16 : 8};
}

absl::Status Damaged() {
  return absl::InvalidArgumentError("damaged or cut-off PNG image");
}

absl::StatusOr<ImageShape> Shape(std::string_view bytes) {
  Png png;
  if (!Create(png, bytes)) return absl::ResourceExhaustedError("out of memory");
  if (setjmp(png_jmpbuf(png.reader)) != 0) return Damaged();
  ReadHeader(png);
  return ShapeOf(png);
}

// False: the library left early.
bool ReadPixels(Png& png, png_bytep* rows, const ImageShape& expected) {
  if (setjmp(png_jmpbuf(png.reader)) != 0) return false;
  ReadHeader(png);
  if (!(ShapeOf(png) == expected)) return false;
  png_set_read_status_fn(png.reader, OnRow);
  png_set_interlace_handling(png.reader);
  png_read_update_info(png.reader, png.info);
  const int sample_bytes = expected.bits / 8;
  if (png_get_rowbytes(png.reader, png.info) !=
      static_cast<size_t>(expected.width) * expected.channels * sample_bytes) {
    return false;
  }
  png_read_image(png.reader, rows);
  png_read_end(png.reader, nullptr);
  return true;
}

absl::Status Decode(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  Png png;
  png.stop = &stop;
  if (!Create(png, bytes)) return absl::ResourceExhaustedError("out of memory");
  std::vector<png_bytep> rows(image.rows);
  for (int y = 0; y < image.rows; ++y) rows[y] = image.ptr(y);
  const ImageShape expected{
      image.cols, image.rows, image.channels(), image.depth() == CV_16U ? 16 : 8};
  if (ReadPixels(png, rows.data(), expected)) return absl::OkStatus();
  if (png.thrown != nullptr) std::rethrow_exception(png.thrown);
  return png.stopped ? absl::CancelledError("stopped while decoding images") : Damaged();
}

}  // namespace

absl::StatusOr<std::string> EncodePng(const cv::Mat& image) {
  png_image about{};
  about.version = PNG_IMAGE_VERSION;
  about.width = static_cast<png_uint_32>(image.cols);
  about.height = static_cast<png_uint_32>(image.rows);
  about.format = PNG_FORMAT_BGR;
  about.flags = PNG_IMAGE_FLAG_FAST;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(about);
  std::string file(size, '\0');
  const int written = png_image_write_to_memory(
      &about, file.data(), &size, 0, image.data, static_cast<png_int_32>(image.step[0]), nullptr);
  png_image_free(&about);
  if (written == 0) return absl::ResourceExhaustedError("a drawing cannot be encoded as PNG");
  file.resize(size);
  file.shrink_to_fit();
  return file;
}

ImageCodec PngCodec() {
  return {"PNG",
          false,
          [](std::string_view bytes) { return bytes.substr(0, kSignature.size()) == kSignature; },
          Shape,
          Decode};
}

}  // namespace horopter
