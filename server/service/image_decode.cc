#include "server/service/image_decode.h"

#include <opencv2/core.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/service/raw_frame.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

absl::Status CheckSize(const ImageShape& shape,
                       const std::string& field,
                       const ImageLimits& limits) {
  const std::string size = absl::StrCat(shape.width, "x", shape.height, " pixels");
  if (shape.width < limits.min_side_px || shape.height < limits.min_side_px) {
    return InvalidField(
        field, absl::StrCat(size, " is too small, need ", limits.min_side_px, " on each side"));
  }
  // Both sides are below 2^32, so that the product fits once one of them is bounded.
  if (shape.width > limits.max_pixels || shape.height > limits.max_pixels / shape.width) {
    return InvalidField(
        field, absl::StrCat(size, " is too large, at most ", limits.max_pixels, " pixels"));
  }
  return absl::OkStatus();
}

// What a codec says, with the field where it is the image's fault.
absl::Status At(const std::string& field, const absl::Status& status) {
  return absl::IsInvalidArgument(status) ? InvalidField(field, std::string(status.message()))
                                         : status;
}

absl::StatusOr<const ImageCodec*> CodecOf(std::string_view bytes,
                                          const std::string& field,
                                          const ImageLimits& limits) {
  if (bytes.empty()) return InvalidField(field, "empty");
  const absl::StatusOr<const ImageCodec*> codec = FindCodec(bytes);
  if (!codec.ok()) {
    return InvalidField(field,
                        absl::StrCat(std::string(codec.status().message()),
                                     "; this server reads ",
                                     ReadFormats(limits.tiff_and_pnm)));
  }
  if ((*codec)->only_on_request && !limits.tiff_and_pnm) {
    return InvalidField(field,
                        absl::StrCat("this server does not read ",
                                     (*codec)->name,
                                     " (--tiff-and-pnm), but ",
                                     ReadFormats(false)));
  }
  return codec;
}

absl::StatusOr<ImageShape> ShapeOf(const ImageCodec& codec,
                                   std::string_view bytes,
                                   const std::string& field,
                                   const ImageLimits& limits) {
  const absl::StatusOr<ImageShape> shape = codec.shape(bytes);
  if (!shape.ok()) return At(field, shape.status());
  HOROPTER_RETURN_IF_ERROR(CheckSize(*shape, field, limits));
  return shape;
}

cv::Mat ImageOf(const ImageShape& shape) {
  return cv::Mat(static_cast<int>(shape.height),
                 static_cast<int>(shape.width),
                 CV_MAKETYPE(shape.bits == 16 ? CV_16U : CV_8U, shape.channels));
}

std::string ContentField(int i) {
  return absl::StrCat("images[", i, "].content");
}
std::string RawField(int i) {
  return absl::StrCat("images[", i, "].raw");
}

absl::StatusOr<cv::Mat> DecodeOne(const v1::SceneImage& image,
                                  int i,
                                  const ImageLimits& limits,
                                  const StopRequested& stop) {
  if (!image.has_raw()) return DecodeImage(image.content(), ContentField(i), limits, stop);
  if (IsStopRequested(stop)) return absl::CancelledError("stopped while decoding images");
  HOROPTER_ASSIGN_OR_RETURN(const ImageShape shape, RawFrameShape(image.raw(), RawField(i)));
  cv::Mat pixels = ImageOf(shape);
  ConvertRawFrame(image.raw(), pixels);
  return pixels;
}

}  // namespace

absl::StatusOr<ImageShape> EncodedShape(std::string_view bytes,
                                        const std::string& field,
                                        const ImageLimits& limits) {
  HOROPTER_ASSIGN_OR_RETURN(const ImageCodec* codec, CodecOf(bytes, field, limits));
  return ShapeOf(*codec, bytes, field, limits);
}

absl::StatusOr<cv::Mat> DecodeImage(std::string_view bytes,
                                    const std::string& field,
                                    const ImageLimits& limits,
                                    const StopRequested& stop) {
  HOROPTER_ASSIGN_OR_RETURN(const ImageCodec* codec, CodecOf(bytes, field, limits));
  HOROPTER_ASSIGN_OR_RETURN(const ImageShape shape, ShapeOf(*codec, bytes, field, limits));
  cv::Mat image = ImageOf(shape);
  if (const absl::Status decoded = codec->decode(bytes, stop, image); !decoded.ok()) {
    return At(field, decoded);
  }
  return shape.bits == 16 ? ScaledTo8Bits(image, BitsInUse(image)) : image;
}

absl::StatusOr<std::vector<ImageShape>> ShapesOf(const v1::RecognizeSceneRequest& request,
                                                 const ImageLimits& limits) {
  if (request.images_size() < 1) return InvalidField("images", "need at least one image");
  if (request.images_size() > kMaxImages) {
    return InvalidField("images",
                        absl::StrCat(request.images_size(), " images, at most ", kMaxImages));
  }
  std::vector<ImageShape> shapes;
  int64_t pixels_left = limits.max_total_pixels;
  for (int i = 0; i < request.images_size(); ++i) {
    const v1::SceneImage& image = request.images(i);
    const std::string field = image.has_raw() ? RawField(i) : ContentField(i);
    absl::StatusOr<ImageShape> shape = image.has_raw()
                                           ? RawFrameShape(image.raw(), field)
                                           : EncodedShape(image.content(), field, limits);
    if (!shape.ok()) return shape.status();
    if (image.has_raw()) HOROPTER_RETURN_IF_ERROR(CheckSize(*shape, field, limits));
    if (shape->width * shape->height > pixels_left) {
      return InvalidField(field,
                          absl::StrCat("with ",
                                       shape->width,
                                       "x",
                                       shape->height,
                                       " pixels the images of the request are too large together, "
                                       "at most ",
                                       limits.max_total_pixels,
                                       " pixels"));
    }
    pixels_left -= shape->width * shape->height;
    shapes.push_back(*shape);
  }
  return shapes;
}

int64_t DecodedBytes(const std::vector<ImageShape>& shapes) {
  int64_t bytes = 0;
  for (const ImageShape& shape : shapes) {
    const int64_t samples = shape.width * shape.height * shape.channels;
    bytes += shape.bits == 16 ? 3 * samples : samples;
    bytes += shape.work_bytes_per_pixel * shape.width * shape.height;
  }
  return bytes;
}

absl::StatusOr<std::vector<cv::Mat>> DecodeImages(const v1::RecognizeSceneRequest& request,
                                                  const ImageLimits& limits,
                                                  int threads,
                                                  const StopRequested& stop) {
  const int n = request.images_size();
  std::vector<absl::StatusOr<cv::Mat>> decoded(n, absl::CancelledError("stopped"));
  ParallelFor(
      n, threads, [&](int i) { decoded[i] = DecodeOne(request.images(i), i, limits, stop); });
  std::vector<cv::Mat> images;
  for (absl::StatusOr<cv::Mat>& image : decoded) {
    if (!image.ok()) return image.status();
    images.push_back(*std::move(image));
  }
  return images;
}

}  // namespace horopter
