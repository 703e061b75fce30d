#include "server/service/image_decode.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "server/service/image_header.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr char kField[] = "images[3].content";

cv::Mat RandomImage(int rows, int cols, int type, int seed = 1) {
  cv::RNG rng(seed);
  cv::Mat image(rows, cols, type);
  rng.fill(image, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_16U ? 65536 : 256);
  return image;
}

std::string Encode(const cv::Mat& image, const char* extension = ".png") {
  std::vector<unsigned char> bytes;
  EXPECT_TRUE(cv::imencode(extension, image, bytes));
  return {bytes.begin(), bytes.end()};
}

absl::StatusOr<cv::Mat> Decode(const std::string& bytes, const ImageLimits& limits = {}) {
  int64_t left = limits.max_total_pixels;
  return DecodeImage(bytes, kField, limits, left);
}

bool SamePixels(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0.0;
}

void ExpectRefused(const absl::StatusOr<cv::Mat>& result, const std::string& says) {
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument) << result.status();
  EXPECT_EQ(ErrorField(result.status()), kField);
  EXPECT_THAT(std::string(result.status().message()), testing::HasSubstr(says));
}

TEST(ImageHeader, AgreesWithTheEncoderInEveryFormat) {
  for (const char* extension : {".png", ".jpg", ".bmp", ".tiff", ".ppm", ".webp"}) {
    for (const cv::Size size : {cv::Size(16, 16), cv::Size(317, 45), cv::Size(20, 700)}) {
      const auto header =
          ReadImageHeader(Encode(RandomImage(size.height, size.width, CV_8UC3), extension));
      ASSERT_TRUE(header.ok()) << extension << header.status();
      EXPECT_EQ(cv::Size(header->width, header->height), size) << extension;
    }
  }
}

TEST(ImageHeader, NoCutAndNoChangedByteDoesHarm) {
  std::mt19937 rng(5);
  for (const char* extension : {".png", ".jpg", ".bmp", ".tiff", ".pgm", ".webp"}) {
    const std::string bytes = Encode(RandomImage(24, 31, CV_8UC1), extension);
    for (size_t size = 0; size < std::min<size_t>(bytes.size(), 400); ++size) {
      (void)ReadImageHeader(bytes.substr(0, size));
    }
    for (int i = 0; i < 2000; ++i) {
      std::string changed = bytes;
      for (int k = 0; k < 3; ++k)
        changed[rng() % std::min<size_t>(bytes.size(), 200)] = static_cast<char>(rng());
      (void)ReadImageHeader(changed);
    }
  }
}

TEST(DecodeImage, KeepsEightBitPixels) {
  const cv::Mat colour = RandomImage(30, 40, CV_8UC3), grey = RandomImage(30, 40, CV_8UC1);
  EXPECT_TRUE(SamePixels(*Decode(Encode(colour)), colour));
  EXPECT_TRUE(SamePixels(*Decode(Encode(grey)), grey));
  EXPECT_TRUE(SamePixels(*Decode(Encode(colour, ".tiff")), colour));
}

TEST(DecodeImage, ScalesSixteenBitsToEight) {
  cv::Mat image(16, 16, CV_16UC1, cv::Scalar(0));
  image.at<uint16_t>(0, 1) = 65535;
  image.at<uint16_t>(0, 2) = 128 * 257;
  const auto decoded = Decode(Encode(image));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(decoded->type(), CV_8UC1);
  EXPECT_EQ(decoded->at<uint8_t>(0, 0), 0);
  EXPECT_EQ(decoded->at<uint8_t>(0, 1), 255);
  EXPECT_EQ(decoded->at<uint8_t>(0, 2), 128);
  EXPECT_EQ(Decode(Encode(RandomImage(20, 20, CV_16UC3)))->type(), CV_8UC3);
}

TEST(DecodeImage, DropsAlpha) {
  const cv::Mat image = RandomImage(20, 20, CV_8UC4);
  cv::Mat colour(image.size(), CV_8UC3);
  cv::mixChannels(image, colour, {0, 0, 1, 1, 2, 2});
  const auto decoded = Decode(Encode(image));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_TRUE(SamePixels(*decoded, colour));
}

TEST(DecodeImage, RefusesWhatIsNoImage) {
  ExpectRefused(Decode(""), "empty");
  ExpectRefused(Decode("hello"), "known format");
  ExpectRefused(Decode(std::string(1000, '\0')), "known format");
  ExpectRefused(Decode("GIF89a" + std::string(100, 'x')), "known format");
}

TEST(DecodeImage, RefusesCutOffImages) {
  for (const char* extension : {".png", ".jpg", ".bmp", ".tiff", ".webp"}) {
    const std::string bytes = Encode(RandomImage(60, 80, CV_8UC3), extension);
    for (const double share : {0.01, 0.1, 0.5, 0.9}) {
      const auto decoded = Decode(bytes.substr(0, static_cast<size_t>(share * bytes.size())));
      EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument)
          << extension << " cut to " << share;
    }
  }
}

TEST(DecodeImage, RefusesSmallImagesBySide) {
  ExpectRefused(Decode(Encode(RandomImage(1, 1, CV_8UC1))), "1x1 pixels is too small");
  ExpectRefused(Decode(Encode(RandomImage(15, 400, CV_8UC1))), "too small");
  EXPECT_TRUE(Decode(Encode(RandomImage(16, 16, CV_8UC1))).ok());
}

TEST(DecodeImage, RefusesHugeImagesByTheirHeaderAlone) {
  // A PNG header that claims 100000 x 100000 pixels; there is no data behind it that could be
  // decoded.
  std::string bytes = Encode(RandomImage(20, 20, CV_8UC1)).substr(0, 33);
  for (const size_t at : {size_t{16}, size_t{20}})
    bytes.replace(at, 4, std::string("\x00\x01\x86\xa0", 4));
  ExpectRefused(Decode(bytes), "100000x100000 pixels is too large");
  bytes.replace(16, 8, std::string(8, '\xff'));
  ExpectRefused(Decode(bytes), "too large");
}

TEST(DecodeImage, CountsThePixelsOfAllImagesTogether) {
  ImageLimits limits;
  limits.max_total_pixels = 1000;
  const std::string bytes = Encode(RandomImage(20, 20, CV_8UC1));
  int64_t left = limits.max_total_pixels;
  EXPECT_TRUE(DecodeImage(bytes, kField, limits, left).ok());
  EXPECT_TRUE(DecodeImage(bytes, kField, limits, left).ok());
  EXPECT_EQ(left, 200);
  ExpectRefused(DecodeImage(bytes, kField, limits, left), "together");
}

}  // namespace
}  // namespace horopter
