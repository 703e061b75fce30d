// HEIC by libheif, which reads the boxes, and libde265, which decodes HEVC. What the file says of
// turns, mirrors and cut-outs belongs to the image (ISO/IEC 23008-12) and is applied.
#include <libheif/heif.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/heif_brands.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

// Planes of brightness and colour in the decoder, in libheif's hands and after their conversion, of
// up to two bytes a sample; tiles are joined as they come.
constexpr int kWorkBytesPerPixel = 16;

using Context = std::unique_ptr<heif_context, decltype(&heif_context_free)>;
using Handle = std::unique_ptr<heif_image_handle, decltype(&heif_image_handle_release)>;
using Image = std::unique_ptr<heif_image, decltype(&heif_image_release)>;
using Options = std::unique_ptr<heif_decoding_options, decltype(&heif_decoding_options_free)>;

// What phones write is not always what this library reads: said with what always is.
absl::Status Refused(const char* what) {
  return absl::InvalidArgumentError(absl::StrCat(what, "; this server reads ", ReadFormats(false)));
}

absl::Status StatusOf(const heif_error& error) {
  switch (error.code) {
    case heif_error_Ok:
      return absl::OkStatus();
    case heif_error_Memory_allocation_error:
      if (error.subcode != heif_suberror_Security_limit_exceeded)
        return absl::ResourceExhaustedError("out of memory");
      return Refused("a HEIC image beyond the limits of its decoder");
    case heif_error_Unsupported_filetype:
    case heif_error_Unsupported_feature:
      return Refused("a HEIC image of a kind that is not read");
    default:
      return Refused("damaged or cut-off HEIC image");
  }
}

void InitializeOnce() {
  static const bool done = [] {
    heif_init(nullptr);
    return true;
  }();
  (void)done;
}

// A file with its first image; `bytes` must outlive it.
struct File {
  Context context{nullptr, heif_context_free};
  Handle primary{nullptr, heif_image_handle_release};
  ImageShape shape;
};

absl::StatusOr<File> Open(std::string_view bytes) {
  InitializeOnce();
  File file;
  file.context.reset(heif_context_alloc());
  if (file.context == nullptr) return absl::ResourceExhaustedError("out of memory");
  // Tiles are decoded by the thread that asked: ImageDecode shares the cores out.
  heif_context_set_max_decoding_threads(file.context.get(), 0);
  HOROPTER_RETURN_IF_ERROR(StatusOf(heif_context_read_from_memory_without_copy(
      file.context.get(), bytes.data(), bytes.size(), nullptr)));
  heif_image_handle* primary = nullptr;
  const heif_error found = heif_context_get_primary_image_handle(file.context.get(), &primary);
  file.primary.reset(primary);
  HOROPTER_RETURN_IF_ERROR(StatusOf(found));
  file.shape = {heif_image_handle_get_width(primary), heif_image_handle_get_height(primary), 3, 8};
  file.shape.work_bytes_per_pixel = kWorkBytesPerPixel;
  if (file.shape.width < 1 || file.shape.height < 1)
    return Refused("damaged or cut-off HEIC image");
  return file;
}

void CopyAsBgr(const uint8_t* rgb, int stride, cv::Mat& image) {
  for (int y = 0; y < image.rows; ++y) {
    const uint8_t* in = rgb + static_cast<ptrdiff_t>(y) * stride;
    unsigned char* out = image.ptr(y);
    for (int x = 0; x < image.cols; ++x, in += 3, out += 3) {
      out[0] = in[2], out[1] = in[1], out[2] = in[0];
    }
  }
}

absl::Status DecodeFile(std::string_view bytes, const StopRequested& stop, cv::Mat& image) {
  if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
  HOROPTER_ASSIGN_OR_RETURN(const File file, Open(bytes));
  if (!(file.shape == ImageShape{image.cols, image.rows, image.channels(), 8}))
    return Refused("damaged or cut-off HEIC image");
  const Options options(heif_decoding_options_alloc(), heif_decoding_options_free);
  if (options == nullptr) return absl::ResourceExhaustedError("out of memory");
  options->convert_hdr_to_8bit = 1;
  options->strict_decoding = 1;
  heif_image* decoded = nullptr;
  const heif_error error = heif_decode_image(file.primary.get(),
                                             &decoded,
                                             heif_colorspace_RGB,
                                             heif_chroma_interleaved_RGB,
                                             options.get());
  const Image pixels(decoded, heif_image_release);
  HOROPTER_RETURN_IF_ERROR(StatusOf(error));
  if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
  int stride = 0;
  const uint8_t* rgb =
      heif_image_get_plane_readonly(pixels.get(), heif_channel_interleaved, &stride);
  if (rgb == nullptr ||
      heif_image_get_width(pixels.get(), heif_channel_interleaved) != image.cols ||
      heif_image_get_height(pixels.get(), heif_channel_interleaved) != image.rows) {
    return Refused("damaged or cut-off HEIC image");
  }
  CopyAsBgr(rgb, stride, image);
  return absl::OkStatus();
}

absl::StatusOr<ImageShape> Shape(std::string_view bytes) {
  HOROPTER_ASSIGN_OR_RETURN(const File file, Open(bytes));
  return file.shape;
}

}  // namespace

ImageCodec HeicCodec() {
  return {"HEIC",
          false,
          [](std::string_view bytes) { return HeifKindOf(bytes) == HeifKind::kHeic; },
          Shape,
          DecodeFile};
}

}  // namespace horopter
