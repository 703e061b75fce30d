#include "server/service/image_decode.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <new>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "horopter/v1/recognition.pb.h"
#include "server/service/rpc_status.h"
#include "tests/support/png_size.h"

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

ImageLimits AllFormats() {
  ImageLimits limits;
  limits.tiff_and_pnm = true;
  return limits;
}

absl::StatusOr<cv::Mat> Decode(const std::string& bytes, const ImageLimits& limits = AllFormats()) {
  return DecodeImage(bytes, kField, limits);
}

absl::StatusOr<ImageShape> Shape(const std::string& bytes) {
  return EncodedShape(bytes, kField, AllFormats());
}

bool SamePixels(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0.0;
}

void ExpectRefused(const absl::StatusOr<cv::Mat>& result, const std::string& says) {
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument) << result.status();
  EXPECT_EQ(ErrorField(result.status()), kField);
  EXPECT_THAT(std::string(result.status().message()), testing::HasSubstr(says));
}

TEST(EncodedShape, AgreesWithTheEncoderInEveryFormat) {
  for (const char* extension : {".png", ".jpg", ".bmp", ".tiff", ".ppm", ".webp"}) {
    for (const cv::Size size : {cv::Size(16, 16), cv::Size(317, 45), cv::Size(20, 700)}) {
      const auto shape = Shape(Encode(RandomImage(size.height, size.width, CV_8UC3), extension));
      ASSERT_TRUE(shape.ok()) << extension << shape.status();
      EXPECT_EQ(*shape, (ImageShape{size.width, size.height, 3, 8})) << extension;
    }
  }
}

// What the codecs make of an image is what OpenCV makes of it.
TEST(DecodeImage, AgreesWithOpenCvInEveryFormat) {
  for (const char* extension : {".png", ".jpg", ".bmp", ".tiff", ".ppm", ".pgm", ".webp"}) {
    for (const int type : {CV_8UC1, CV_8UC3}) {
      if (std::string(extension) == ".ppm" && type == CV_8UC1) continue;
      if (std::string(extension) == ".pgm" && type == CV_8UC3) continue;
      const std::string bytes = Encode(RandomImage(45, 317, type), extension);
      const auto decoded = Decode(bytes);
      ASSERT_TRUE(decoded.ok()) << extension << decoded.status();
      const cv::Mat expected = cv::imdecode(std::vector<uchar>(bytes.begin(), bytes.end()),
                                            cv::IMREAD_ANYCOLOR | cv::IMREAD_ANYDEPTH);
      EXPECT_TRUE(SamePixels(*decoded, expected)) << extension << " " << type;
    }
  }
}

TEST(DecodeImage, OneHeaderRulesTheSizeOfThePixels) {
  ImageLimits limits = AllFormats();
  limits.max_pixels = 1'000'000;
  // A comment of PNM ends at a carriage return too.
  const std::string pnm = "P6\n#\r30000 30000 255\n16 16 255\n" + std::string(768, 'x');
  ExpectRefused(DecodeImage(pnm, kField, limits), "");
  // The width of a TIFF given twice: whichever is taken for the check is taken for the pixels.
  for (const bool huge_first : {true, false}) {
    std::string tiff = Encode(RandomImage(16, 16, CV_8UC1), ".tiff");
    const auto at = [&](size_t i, int n) {
      uint32_t value = 0;
      std::memcpy(&value, tiff.data() + i, static_cast<size_t>(n));
      return value;
    };
    const size_t directory = at(4, 4);
    const uint32_t count = at(directory, 2);
    // Overwrites the entry of no use to a decoder (say, the resolution unit) with a second width.
    std::string huge = tiff.substr(directory + 2, 12);
    ASSERT_EQ(at(directory + 2, 2), 256u);
    huge[2] = 4, huge[3] = 0;
    std::memcpy(huge.data() + 8, "\x30\x75\0\0", 4);  // 30000
    std::string entries = tiff.substr(directory + 2, 12 * count);
    entries = huge_first ? huge + entries : entries.substr(0, 12) + huge + entries.substr(12);
    const auto entry_count = static_cast<uint16_t>(count + 1);
    std::string end(4, '\0');
    std::string changed = tiff;
    const auto moved = static_cast<uint32_t>(tiff.size());
    std::memcpy(changed.data() + 4, &moved, 4);
    changed.append(reinterpret_cast<const char*>(&entry_count), 2);
    changed += entries + end;
    const auto decoded = DecodeImage(changed, kField, limits);
    if (decoded.ok()) {
      EXPECT_EQ(decoded->size(), cv::Size(16, 16));
    }
  }
}

TEST(DecodeImage, TiffAndPnmAreBehindASwitch) {
  for (const char* extension : {".tiff", ".ppm"}) {
    const std::string bytes = Encode(RandomImage(20, 20, CV_8UC3), extension);
    EXPECT_TRUE(Decode(bytes).ok());
    ExpectRefused(Decode(bytes, ImageLimits()), "does not read");
  }
}

// JPEG allows markers without a length before the frame header.
TEST(DecodeImage, JpegMarkersWithoutLengthAreReadOver) {
  const cv::Mat image = RandomImage(20, 30, CV_8UC3);
  std::string bytes = Encode(image, ".jpg");
  bytes.insert(2, "\xff\x01");  // TEM
  const auto decoded = Decode(bytes);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(decoded->size(), image.size());
}

TEST(DecodeImage, IsStoppedWhileItDecodes) {
  for (const char* extension : {".png", ".jpg", ".bmp", ".webp", ".pgm"}) {
    const std::string bytes = Encode(RandomImage(400, 400, CV_8UC1), extension);
    int looks = 0;
    const auto stop = [&] { return ++looks > 1; };
    EXPECT_EQ(DecodeImage(bytes, kField, AllFormats(), stop).status().code(),
              absl::StatusCode::kCancelled)
        << extension;
    const auto fail = []() -> bool { throw std::bad_alloc(); };
    EXPECT_THROW((void)DecodeImage(bytes, kField, AllFormats(), fail), std::bad_alloc) << extension;
  }
}

// Differential: whatever was done to an image's bytes, a decoded one has the size and type that its
// header said, within the limits; nothing is read or written out of bounds (with the sanitizers).
TEST(DecodeImage, MutatedImagesAreRefusedOrHaveTheSizeOfTheirHeader) {
  std::mt19937 rng(7);
  ImageLimits limits = AllFormats();
  limits.max_pixels = 4000;
  for (const char* extension : {".png", ".jpg", ".bmp", ".tiff", ".pgm", ".webp"}) {
    const std::string bytes = Encode(RandomImage(24, 31, CV_8UC1), extension);
    int accepted = 0;
    for (int i = 0; i < 1500; ++i) {
      std::string changed = bytes;
      const size_t reach = i % 2 == 0 ? 64 : bytes.size();
      for (unsigned k = 0; k < 1 + rng() % 3; ++k)
        changed[rng() % std::min(bytes.size(), reach)] = static_cast<char>(rng());
      if (i % 5 == 0) changed.resize(rng() % changed.size());
      if (i % 7 == 0) changed.insert(rng() % (changed.size() + 1), changed.substr(0, rng() % 40));
      const auto shape = EncodedShape(changed, kField, limits);
      const auto decoded = DecodeImage(changed, kField, limits);
      if (!decoded.ok()) {
        EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument) << decoded.status();
        continue;
      }
      ++accepted;
      ASSERT_TRUE(shape.ok());
      EXPECT_EQ(decoded->size(), cv::Size(shape->width, shape->height)) << extension;
      EXPECT_EQ(decoded->channels(), shape->channels) << extension;
      EXPECT_LE(static_cast<int64_t>(decoded->total()), limits.max_pixels);
    }
    EXPECT_GT(accepted, 0) << extension;
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
  // There is no data behind the header that could be decoded.
  const std::string bytes = Encode(RandomImage(20, 20, CV_8UC1)).substr(0, 45);
  ExpectRefused(Decode(WithPngSize(bytes, 100000, 100000)), "100000x100000 pixels is too large");
  ExpectRefused(Decode(WithPngSize(bytes, 1u << 29, 1u << 29)), "too large");
  ExpectRefused(Decode(WithPngSize(bytes, 0xffffffffu, 0xffffffffu)), "damaged");
}

v1::RawFrame Frame(v1::RawFrame::PixelFormat format, int width, int height, const cv::Mat& rows) {
  v1::RawFrame frame;
  frame.set_format(format);
  frame.set_width_px(width);
  frame.set_height_px(height);
  frame.set_stride_bytes(static_cast<int>(rows.step));
  frame.set_data(rows.data, rows.step * static_cast<size_t>(rows.rows));
  return frame;
}

absl::StatusOr<std::vector<cv::Mat>> DecodeRaw(const v1::RawFrame& frame) {
  v1::RecognizeSceneRequest request;
  *request.add_images()->mutable_raw() = frame;
  if (const auto shapes = ShapesOf(request, {}); !shapes.ok()) return shapes.status();
  return DecodeImages(request, {}, 2, {});
}

TEST(RawFrames, OfEveryFormatBecomeThePixelsTheyStandFor) {
  const cv::Mat padded = RandomImage(20, 40, CV_8UC3);
  const cv::Mat bgr = padded.colRange(0, 30);
  cv::Mat rgb, grey = RandomImage(20, 30, CV_8UC1);
  cv::cvtColor(padded, rgb, cv::COLOR_BGR2RGB);
  EXPECT_TRUE(
      SamePixels((*DecodeRaw(Frame(v1::RawFrame::PIXEL_FORMAT_BGR8, 30, 20, padded)))[0], bgr));
  EXPECT_TRUE(
      SamePixels((*DecodeRaw(Frame(v1::RawFrame::PIXEL_FORMAT_RGB8, 30, 20, rgb)))[0], bgr));
  EXPECT_TRUE(
      SamePixels((*DecodeRaw(Frame(v1::RawFrame::PIXEL_FORMAT_GRAY8, 30, 20, grey)))[0], grey));
  // One colour all over: the red of a mosaic that begins red, and the brightness of NV12.
  cv::Mat mosaic(20, 30, CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < 20; y += 2) {
    for (int x = 0; x < 30; x += 2) mosaic.at<uchar>(y, x) = 200;
  }
  const cv::Mat red = (*DecodeRaw(Frame(v1::RawFrame::PIXEL_FORMAT_BAYER_RG8, 30, 20, mosaic)))[0];
  EXPECT_EQ(red.at<cv::Vec3b>(10, 14), cv::Vec3b(0, 0, 200));
  cv::Mat nv12(30, 30, CV_8UC1, cv::Scalar(128));
  nv12.rowRange(0, 20).setTo(235);
  const cv::Mat white = (*DecodeRaw(Frame(v1::RawFrame::PIXEL_FORMAT_NV12, 30, 20, nv12)))[0];
  EXPECT_EQ(white.size(), cv::Size(30, 20));
  EXPECT_EQ(white.at<cv::Vec3b>(10, 14), cv::Vec3b(255, 255, 255));
}

TEST(RawFrames, ThatContradictThemselvesAreRefusedByField) {
  const cv::Mat grey = RandomImage(20, 30, CV_8UC1);
  const v1::RawFrame good = Frame(v1::RawFrame::PIXEL_FORMAT_GRAY8, 30, 20, grey);
  const auto field = [&](const std::function<void(v1::RawFrame&)>& change) {
    v1::RawFrame frame = good;
    change(frame);
    return ErrorField(DecodeRaw(frame).status());
  };
  EXPECT_TRUE(DecodeRaw(good).ok());
  EXPECT_EQ(field([](auto& f) { f.set_width_px(0); }), "images[0].raw.width_px");
  EXPECT_EQ(field([](auto& f) { f.set_height_px(-4); }), "images[0].raw.height_px");
  EXPECT_EQ(field([](auto& f) { f.clear_format(); }), "images[0].raw.format");
  EXPECT_EQ(field([](auto& f) { f.set_stride_bytes(29); }), "images[0].raw.stride_bytes");
  EXPECT_EQ(field([](auto& f) { f.set_stride_bytes(-30); }), "images[0].raw.stride_bytes");
  EXPECT_EQ(field([](auto& f) { f.mutable_data()->pop_back(); }), "images[0].raw.data");
  EXPECT_EQ(field([](auto& f) { f.set_height_px(2147483647); }), "images[0].raw.data");
  EXPECT_EQ(field([](auto& f) {
              f.set_format(v1::RawFrame::PIXEL_FORMAT_NV12);
              f.set_height_px(13);
            }),
            "images[0].raw.format");
}

TEST(ShapesOf, CountsThePixelsOfAllImagesTogether) {
  ImageLimits limits;
  limits.max_total_pixels = 1000;
  v1::RecognizeSceneRequest request;
  request.add_images()->set_content(Encode(RandomImage(20, 20, CV_8UC1)));
  *request.add_images()->mutable_raw() =
      Frame(v1::RawFrame::PIXEL_FORMAT_GRAY8, 20, 20, RandomImage(20, 20, CV_8UC1));
  const auto shapes = ShapesOf(request, limits);
  ASSERT_TRUE(shapes.ok()) << shapes.status();
  EXPECT_EQ(DecodedBytes(*shapes), 800);
  request.add_images()->set_content(Encode(RandomImage(20, 20, CV_8UC1)));
  const absl::Status refused = ShapesOf(request, limits).status();
  EXPECT_EQ(ErrorField(refused), "images[2].content");
  EXPECT_THAT(std::string(refused.message()), testing::HasSubstr("together"));
}

}  // namespace
}  // namespace horopter
