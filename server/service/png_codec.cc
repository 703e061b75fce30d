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
// Of Adam7, which are numbered from 0.
constexpr int kLastPass = 6;

struct Png {
  png_structp reader = nullptr;
  png_infop info = nullptr;
  std::string_view left;
  ImageShape expected;
  std::vector<png_bytep> rows;
  bool whole = false;  // the last row has come
  const StopRequested* stop = nullptr;
  bool stopped = false;
  std::exception_ptr thrown;  // by `stop`; must not pass through the library

  ~Png() { png_destroy_read_struct(&reader, &info, nullptr); }
};

void OnPngError(png_structp reader, png_const_charp) {
  png_longjmp(reader, 1);
}
void OnWarning(png_structp, png_const_charp) {}

void OnRead(png_structp reader, png_bytep out, size_t size) {
  Png& png = *static_cast<Png*>(png_get_io_ptr(reader));
  if (size > png.left.size()) png_error(reader, "cut off");
  std::memcpy(out, png.left.data(), size);
  png.left.remove_prefix(size);
}

bool Create(Png& png, std::string_view bytes) {
  png.left = bytes;
  png.reader = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, OnPngError, OnWarning);
  if (png.reader != nullptr) png.info = png_create_info_struct(png.reader);
  return png.info != nullptr;
}

void SetPngLimits(Png& png) {
  png_set_user_limits(png.reader, kMaxSide, kMaxSide);
  png_set_chunk_malloc_max(png.reader, kMaxChunkBytes);
  png_set_chunk_cache_max(png.reader, kMaxChunks);
}

// To grey or BGR.
void SetTransformations(Png& png) {
  png_set_expand(png.reader);  // palettes to colours, fewer than 8 bits to 8
  png_set_strip_alpha(png.reader);
  png_set_bgr(png.reader);
  png_set_swap(png.reader);
}

ImageShape PngShape(const Png& png) {
  const bool colour = (png_get_color_type(png.reader, png.info) & PNG_COLOR_MASK_COLOR) != 0;
  return {png_get_image_width(png.reader, png.info),
          png_get_image_height(png.reader, png.info),
          colour ? 3 : 1,
          png_get_bit_depth(png.reader, png.info) == 16 ? 16 : 8};
}

absl::Status DamagedPng() {
  return absl::InvalidArgumentError("damaged or cut-off PNG image");
}

absl::StatusOr<ImageShape> ReadPngShape(std::string_view bytes) {
  Png png;
  if (!Create(png, bytes)) return absl::ResourceExhaustedError("out of memory");
  if (setjmp(png_jmpbuf(png.reader)) != 0) return DamagedPng();
  SetPngLimits(png);
  png_set_read_fn(png.reader, &png, OnRead);
  png_read_info(png.reader, png.info);
  SetTransformations(png);
  return PngShape(png);
}

// Bytes of the file up to the first chunk behind the pixels: what follows says nothing of them, and
// need not be there.
std::string_view UpToLastPixels(std::string_view bytes) {
  size_t at = kSignature.size();
  bool pixels = false;
  while (at + 8 <= bytes.size()) {
    uint32_t length = 0;
    for (size_t i = 0; i < 4; ++i) length = length << 8 | static_cast<unsigned char>(bytes[at + i]);
    const bool is_pixels = bytes.substr(at + 4, 4) == "IDAT";
    if (pixels && !is_pixels) return bytes.substr(0, at);
    pixels = is_pixels;
    at += size_t{12} + length;
  }
  return bytes;
}

// The library's progressive reader gives every row as soon as it is known, where the other one
// gives none of a file that it cannot read to its end.
void OnInfo(png_structp reader, png_infop) {
  Png& png = *static_cast<Png*>(png_get_progressive_ptr(reader));
  SetTransformations(png);
  if (!(PngShape(png) == png.expected)) png_error(reader, "another shape");
  png_set_interlace_handling(reader);
  png_read_update_info(reader, png.info);
  const auto row_bytes =
      static_cast<size_t>(png.expected.width * png.expected.channels * (png.expected.bits / 8));
  if (png_get_rowbytes(reader, png.info) != row_bytes) png_error(reader, "another size");
}

void OnRow(png_structp reader, png_bytep row, png_uint_32 y, int pass) {
  Png& png = *static_cast<Png*>(png_get_progressive_ptr(reader));
  try {
    png.stopped = png.stop != nullptr && IsStopRequested(*png.stop);
  } catch (...) {
    png.thrown = std::current_exception();
  }
  if (png.stopped || png.thrown != nullptr) png_error(reader, "stopped");
  if (row != nullptr) png_progressive_combine_row(reader, png.rows[y], row);
  const bool last_pass =
      png_get_interlace_type(reader, png.info) == PNG_INTERLACE_NONE || pass == kLastPass;
  if (last_pass && y + 1 == png.expected.height) png.whole = true;
}

// False: the library left early, or not every row was there.
bool ReadPixels(Png& png, std::string_view bytes) {
  if (setjmp(png_jmpbuf(png.reader)) != 0) return false;
  SetPngLimits(png);
  png_set_progressive_read_fn(png.reader, &png, OnInfo, OnRow, nullptr);
  // Only reads, but for the library's signature.
  auto* data = const_cast<png_bytep>(reinterpret_cast<png_const_bytep>(bytes.data()));
  png_process_data(png.reader, png.info, data, bytes.size());
  return png.whole;
}

absl::Status DecodePng(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  Png png;
  png.stop = &stop;
  png.expected = {image.cols, image.rows, image.channels(), image.depth() == CV_16U ? 16 : 8};
  for (int y = 0; y < image.rows; ++y) png.rows.push_back(image.ptr(y));
  if (!Create(png, bytes)) return absl::ResourceExhaustedError("out of memory");
  if (ReadPixels(png, UpToLastPixels(bytes))) return absl::OkStatus();
  if (png.thrown != nullptr) std::rethrow_exception(png.thrown);
  return png.stopped ? absl::CancelledError("stopped while decoding images") : DamagedPng();
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
          ReadPngShape,
          DecodePng};
}

}  // namespace horopter
