// HEIC files, made by the library's own encoder where it has one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <libheif/heif.h>

#include <cstring>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>

#include "server/service/exif.h"
#include "server/service/image_decode.h"

namespace horopter {
namespace {

constexpr char kField[] = "images[0].content";

absl::StatusOr<cv::Mat> Decode(const std::string& bytes, const StopRequested& stop = {}) {
  return DecodeImage(bytes, kField, ImageLimits(), stop);
}

cv::Mat Gradient(int width, int height) {
  cv::Mat image(height, width, CV_8UC3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      image.at<cv::Vec3b>(y, x) = {static_cast<uchar>(255 * x / width),
                                   static_cast<uchar>(255 * y / height),
                                   static_cast<uchar>(x / 16 % 2 == 0 ? 60 : 160)};
    }
  }
  return image;
}

heif_error Append(heif_context*, const void* data, size_t size, void* out) {
  static_cast<std::string*>(out)->append(static_cast<const char*>(data), size);
  return {heif_error_Ok, heif_suberror_Unspecified, ""};
}

// A file of the BGR image; nothing where the library cannot encode. `exif` is put in as a camera
// puts it in.
std::optional<std::string> EncodeHeic(const cv::Mat& image, const std::string& exif = "") {
  heif_init(nullptr);
  heif_context* context = heif_context_alloc();
  heif_encoder* encoder = nullptr;
  heif_context_get_encoder_for_format(context, heif_compression_HEVC, &encoder);
  if (encoder == nullptr) {
    heif_context_free(context);
    return std::nullopt;
  }
  heif_encoder_set_lossy_quality(encoder, 95);
  heif_encoder_set_parameter_string(encoder, "preset", "ultrafast");
  heif_image* pixels = nullptr;
  heif_image_create(
      image.cols, image.rows, heif_colorspace_RGB, heif_chroma_interleaved_RGB, &pixels);
  heif_image_add_plane(pixels, heif_channel_interleaved, image.cols, image.rows, 8);
  int stride = 0;
  uint8_t* plane = heif_image_get_plane(pixels, heif_channel_interleaved, &stride);
  cv::Mat rgb;
  cv::cvtColor(image, rgb, cv::COLOR_BGR2RGB);
  for (int y = 0; y < rgb.rows; ++y) std::memcpy(plane + y * stride, rgb.ptr(y), 3 * rgb.cols);
  heif_image_handle* handle = nullptr;
  std::string file;
  EXPECT_EQ(heif_context_encode_image(context, pixels, encoder, nullptr, &handle).code,
            heif_error_Ok);
  if (!exif.empty()) {
    heif_context_add_exif_metadata(context, handle, exif.data(), static_cast<int>(exif.size()));
  }
  heif_writer writer{1, Append};
  EXPECT_EQ(heif_context_write(context, &writer, &file).code, heif_error_Ok);
  heif_image_handle_release(handle);
  heif_image_release(pixels);
  heif_encoder_release(encoder);
  heif_context_free(context);
  return file;
}

#define HEIC_OR_SKIP(name, ...)                                         \
  const std::optional<std::string> name##_or = EncodeHeic(__VA_ARGS__); \
  if (!name##_or) GTEST_SKIP() << "this libheif has no encoder";        \
  const std::string& name = *name##_or

TEST(HeicCodec, WhatCannotBeReadIsNamedWithTheFormatsThatAre) {
  std::ifstream file(HOROPTER_TEST_DATA "/inputs/images/phone_0.heic", std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(file), {}};
  const absl::Status refused = Decode(bytes).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(refused.message()), testing::HasSubstr("HEIC image"));
  EXPECT_THAT(std::string(refused.message()),
              testing::HasSubstr("reads JPEG, PNG, WebP, BMP, HEIC"));
}

// The picture of the samples as a phone would have taken it.
TEST(HeicCodec, AnImageOfTheSamplesIsThePicture) {
  const cv::Mat picture = cv::imread(HOROPTER_TEST_DATA "/parts/val/000001/rgb/000000.png")(
                              cv::Rect(160, 120, 320, 240))
                              .clone();
  HEIC_OR_SKIP(bytes, picture);
  const auto decoded = Decode(bytes);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  ASSERT_EQ(decoded->size(), picture.size());
  EXPECT_LT(cv::norm(*decoded, picture, cv::NORM_L1) / (3.0 * picture.total()), 4.0);
}

TEST(HeicCodec, GivesTheSizeOfItsHeaderAndTheColours) {
  for (const cv::Size size : {cv::Size(64, 64), cv::Size(117, 45), cv::Size(20, 170)}) {
    const cv::Mat image = Gradient(size.width, size.height);
    HEIC_OR_SKIP(bytes, image);
    const auto shape = EncodedShape(bytes, kField, ImageLimits());
    ASSERT_TRUE(shape.ok()) << shape.status();
    EXPECT_EQ(*shape, (ImageShape{size.width, size.height, 3, 8}));
    EXPECT_GT(DecodedBytes({*shape}), 3 * size.area());
    const auto decoded = Decode(bytes);
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    ASSERT_EQ(decoded->size(), size);
    EXPECT_LT(cv::norm(*decoded, image, cv::NORM_L1) / (3.0 * image.total()), 12.0);
  }
}

TEST(HeicCodec, CutOffAndChangedFilesAreRefusedOrHaveTheSizeOfTheirHeader) {
  HEIC_OR_SKIP(bytes, Gradient(96, 64));
  for (const double share : {0.01, 0.1, 0.5, 0.9, 0.99}) {
    const auto decoded = Decode(bytes.substr(0, static_cast<size_t>(share * bytes.size())));
    EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument) << share;
  }
  std::mt19937 rng(7);
  ImageLimits limits;
  limits.max_pixels = 100'000;
  int accepted = 0;
  for (int i = 0; i < 60; ++i) {
    std::string changed = bytes;
    for (unsigned k = 0; k < 1 + rng() % 3; ++k)
      changed[rng() % changed.size()] = static_cast<char>(rng());
    const auto shape = EncodedShape(changed, kField, limits);
    const auto decoded = DecodeImage(changed, kField, limits);
    if (!decoded.ok()) {
      EXPECT_THAT(
          decoded.status().code(),
          testing::AnyOf(absl::StatusCode::kInvalidArgument, absl::StatusCode::kResourceExhausted))
          << decoded.status();
      continue;
    }
    ++accepted;
    ASSERT_TRUE(shape.ok());
    EXPECT_EQ(decoded->size(), cv::Size(shape->width, shape->height));
  }
  EXPECT_GT(accepted, 0);
}

TEST(HeicCodec, AHeaderThatSaysLessThanThereIsDoesNotRuleTheLimits) {
  HEIC_OR_SKIP(honest, Gradient(512, 384));
  std::string bytes = honest;
  const std::string size{'\0', '\0', '\x02', '\0', '\0', '\0', '\x01', '\x80'};
  const std::string small{'\0', '\0', '\0', '\x40', '\0', '\0', '\0', '\x30'};
  int replaced = 0;
  for (size_t at = bytes.find(size); at != bytes.npos; at = bytes.find(size)) {
    bytes.replace(at, size.size(), small);
    ++replaced;
  }
  ASSERT_GT(replaced, 0);
  const auto decoded = Decode(bytes);
  if (decoded.ok()) EXPECT_EQ(decoded->size(), cv::Size(64, 48));
}

TEST(HeicCodec, IsStopped) {
  HEIC_OR_SKIP(bytes, Gradient(96, 64));
  EXPECT_EQ(Decode(bytes, [] { return true; }).status().code(), absl::StatusCode::kCancelled);
}

// As a camera writes it: 35 mm equivalent 28, and an orientation that the image's own turn repeats.
TEST(HeicCodec, ExifGivesTheFocalLengthAndNoSecondTurn) {
  using namespace std::string_literals;
  const std::string tiff =
      "MM\0*\0\0\0\x08"s
      "\0\x02"s
      "\x01\x12\0\x03\0\0\0\x01\0\x06\0\0"s  // orientation 6
      "\x87\x69\0\x04\0\0\0\x01\0\0\0\x26"s  // Exif's directory at 38
      "\0\0\0\0"s
      "\0\x01"s
      "\xa4\x05\0\x03\0\0\0\x01\0\x1c\0\0"s  // 28 mm on film
      "\0\0\0\0"s;
  HEIC_OR_SKIP(bytes, Gradient(64, 64), "Exif\0\0"s + tiff);
  const Exif exif = ReadExif(bytes);
  ASSERT_TRUE(exif.focal_35mm.has_value());
  EXPECT_EQ(*exif.focal_35mm, 28.0);
  EXPECT_EQ(exif.orientation, 1);
}

}  // namespace
}  // namespace horopter
