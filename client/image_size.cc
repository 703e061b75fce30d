#include "client/image_size.h"

#include <libheif/heif.h>

#include <algorithm>
#include <exception>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <vector>

namespace horopter {
namespace {

// Empty: it is no HEIC image that can be read. OpenCV has no reader of them.
cv::Size HeicSize(const std::string& bytes) {
  const std::unique_ptr<heif_context, decltype(&heif_context_free)> context(heif_context_alloc(),
                                                                            heif_context_free);
  if (context == nullptr ||
      heif_context_read_from_memory_without_copy(context.get(), bytes.data(), bytes.size(), nullptr)
              .code != heif_error_Ok)
    return {};
  heif_image_handle* first = nullptr;
  if (heif_context_get_primary_image_handle(context.get(), &first).code != heif_error_Ok) return {};
  const std::unique_ptr<heif_image_handle, decltype(&heif_image_handle_release)> primary(
      first, heif_image_handle_release);
  return {heif_image_handle_get_width(primary.get()), heif_image_handle_get_height(primary.get())};
}

bool MayBeHeic(const std::string& bytes) {
  return heif_check_filetype(reinterpret_cast<const uint8_t*>(bytes.data()),
                             static_cast<int>(std::min<size_t>(bytes.size(), 1 << 10))) !=
         heif_filetype_no;
}

}  // namespace

absl::StatusOr<cv::Size> EncodedImageSize(const std::string& bytes) {
  cv::Size size;
  try {
    if (MayBeHeic(bytes)) {
      size = HeicSize(bytes);
    } else {
      size = cv::imdecode(std::vector<uchar>(bytes.begin(), bytes.end()),
                          cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION)
                 .size();
    }
  } catch (const std::exception&) {
  }
  if (size.width > 0 && size.height > 0) return size;
  return absl::InvalidArgumentError("cannot be decoded");
}

}  // namespace horopter
