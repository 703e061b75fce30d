#include "server/service/image_decode.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>
#include <functional>
#include <new>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <tuple>

#include "horopter/v1/recognition.pb.h"
#include "server/service/rpc_status.h"
#include "tests/server/service/image_samples.h"
#include "tests/support/png_size.h"

namespace horopter {
namespace {

constexpr char kField[] = "images[3].content";

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
}

// Files of our own making, described in tests/data/inputs/images/README.md.
std::string InputFile(const std::string& name) {
  std::ifstream file(HOROPTER_TEST_DATA "/inputs/images/" + name, std::ios::binary);
  EXPECT_TRUE(file) << name;
  return {std::istreambuf_iterator<char>(file), {}};
}

// The picture that the files stand for, grey.
cv::Mat Picture(int i) {
  return cv::imread(HOROPTER_TEST_DATA "/parts/val/000001/rgb/00000" + std::to_string(i) + ".png",
                    cv::IMREAD_GRAYSCALE);
}

double MeanDifference(const cv::Mat& decoded, const cv::Mat& grey) {
  cv::Mat as_grey = decoded;
  if (decoded.channels() == 3) cv::cvtColor(decoded, as_grey, cv::COLOR_BGR2GRAY);
  EXPECT_EQ(as_grey.size(), grey.size());
  return as_grey.size() == grey.size() ? cv::norm(as_grey, grey, cv::NORM_L1) / grey.total()
                                       : 255.0;
}

TEST(DecodeImage, TwelveBitsInWordsOfSixteenAreThePicture) {
  for (int i = 0; i < 3; ++i) {
    const auto decoded = Decode(InputFile("png16_12bit_" + std::to_string(i) + ".png"));
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_LT(MeanDifference(*decoded, Picture(i)), 1.0);
  }
}

TEST(DecodeImage, BitsInUseAreScaledInEveryFormatThatHasSixteen) {
  const cv::Mat grey = RandomImage(40, 50, CV_8UC1, 3), colour = RandomImage(40, 50, CV_8UC3, 4);
  for (const cv::Mat& image : {grey, colour}) {
    for (const int bits : {8, 10, 12, 14, 16}) {
      cv::Mat wide;
      image.convertTo(wide, CV_16U, ((1 << bits) - 1) / 255.0);
      for (const char* extension : {".png", ".tiff", image.channels() == 1 ? ".pgm" : ".ppm"}) {
        const auto decoded = Decode(Encode(wide, extension));
        ASSERT_TRUE(decoded.ok()) << extension << decoded.status();
        EXPECT_LE(cv::norm(*decoded, image, cv::NORM_INF), 1.0) << extension << " " << bits;
      }
    }
  }
}

// PGM says itself up to what its samples are.
TEST(DecodeImage, PnmOfAnyLargestSampleIsStretched) {
  const auto pgm = [](int most, const std::string& samples) {
    return "P5 16 16 " + std::to_string(most) + "\n" + samples;
  };
  std::string narrow(256, '\x3f'), wide;
  narrow[0] = 0;
  for (int i = 0; i < 256; ++i) wide += i == 0 ? std::string(2, '\0') : std::string("\x03\xff", 2);
  for (const std::string& file : {pgm(63, narrow), pgm(1023, wide)}) {
    const auto decoded = Decode(file);
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_EQ(decoded->at<uint8_t>(0, 0), 0);
    EXPECT_EQ(decoded->at<uint8_t>(0, 1), 255);
  }
  ExpectRefused(Decode(pgm(0, narrow)), "damaged");
  ExpectRefused(Decode(pgm(65536, wide)), "damaged");
}

TEST(DecodeImage, JpegsOfOurInputsWithoutEndMarkAreRead) {
  for (int i = 0; i < 3; ++i) {
    const auto decoded = Decode(InputFile("noeoi_" + std::to_string(i) + ".jpg"));
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_LT(MeanDifference(*decoded, Picture(i)), 3.0);
  }
}

std::string EncodeJpeg(const cv::Mat& image, const std::vector<int>& how) {
  std::vector<unsigned char> bytes;
  EXPECT_TRUE(cv::imencode(".jpg", image, bytes, how));
  return {bytes.begin(), bytes.end()};
}

// Whatever is behind the last row does not matter; what is before it does.
TEST(DecodeImage, JpegWithoutItsEndMarkIsReadAndOneWithoutItsLastBytesIsNot) {
  cv::Mat image(120, 160, CV_8UC3);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x)
      image.at<cv::Vec3b>(y, x) = {uchar(x), uchar(y), uchar(x ^ y)};
  }
  for (const std::vector<int>& how :
       std::vector<std::vector<int>>{{},
                                     {cv::IMWRITE_JPEG_PROGRESSIVE, 1},
                                     {cv::IMWRITE_JPEG_RST_INTERVAL, 4},
                                     {cv::IMWRITE_JPEG_OPTIMIZE, 1}}) {
    const std::string whole = EncodeJpeg(image, how);
    const cv::Mat expected = *Decode(whole);
    for (const std::string& end : {std::string(), std::string("\xff"), std::string(100, '\0')}) {
      const auto decoded = Decode(whole.substr(0, whole.size() - 2) + end);
      ASSERT_TRUE(decoded.ok()) << decoded.status() << how.size();
      EXPECT_TRUE(SamePixels(*decoded, expected));
    }
    for (const size_t cut : {8u, 20u, 100u, 400u}) {
      EXPECT_FALSE(Decode(whole.substr(0, whole.size() - cut)).ok()) << cut;
    }
  }
}

// A progressive file that ends between two scans has every row, but not all of it.
TEST(DecodeImage, AProgressiveJpegWithoutItsLastScansIsCutOff) {
  const std::string whole =
      EncodeJpeg(RandomImage(64, 64, CV_8UC3), {cv::IMWRITE_JPEG_PROGRESSIVE, 1});
  int scans = 0;
  for (size_t at = whole.find("\xff\xda"); at != whole.npos; at = whole.find("\xff\xda", at + 2)) {
    if (++scans == 1) continue;
    EXPECT_FALSE(Decode(whole.substr(0, at)).ok()) << scans;
    EXPECT_FALSE(Decode(whole.substr(0, at) + "\xff").ok()) << scans;
  }
  EXPECT_GT(scans, 3);
}

TEST(DecodeImage, PngWithoutItsEndMarkIsReadAndOneWithoutItsLastRowIsNot) {
  for (const int type : {CV_8UC1, CV_8UC3, CV_16UC1, CV_8UC4}) {
    const std::string whole = Encode(RandomImage(50, 60, type));
    const cv::Mat expected = *Decode(whole);
    ASSERT_EQ(whole.substr(whole.size() - 8, 4), "IEND");
    // Without IEND, with a part of it, and without the checksums of the pixels as well.
    for (const size_t cut : {1u, 6u, 12u, 14u, 16u, 18u}) {
      const auto decoded = Decode(whole.substr(0, whole.size() - cut));
      ASSERT_TRUE(decoded.ok()) << decoded.status() << cut;
      EXPECT_TRUE(SamePixels(*decoded, expected)) << cut;
    }
    const auto padded = Decode(whole.substr(0, whole.size() - 12) + std::string(50, '\0'));
    ASSERT_TRUE(padded.ok()) << padded.status();
    EXPECT_TRUE(SamePixels(*padded, expected));
    EXPECT_FALSE(Decode(whole.substr(0, whole.size() - 60)).ok());
    std::string damaged = whole;
    damaged[whole.size() - 40] ^= 1;  // the checksum of the pixels tells
    EXPECT_FALSE(Decode(damaged).ok());
  }
}

TEST(DecodeImage, BmpWithoutThePaddingOfItsLastRowIsRead) {
  const cv::Mat image = RandomImage(20, 21, CV_8UC3);  // 63 bytes a row, one of padding
  const std::string whole = Encode(image, ".bmp");
  const auto decoded = Decode(whole.substr(0, whole.size() - 1));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_TRUE(SamePixels(*decoded, image));
  EXPECT_FALSE(Decode(whole.substr(0, whole.size() - 2)).ok());
}

TEST(DecodeImage, UnknownFormatsAreNamedWithThoseThatAreRead) {
  using namespace std::string_literals;
  const auto brand = [](const std::string& major, const std::string& others) {
    return "\0\0\0\x20"s + "ftyp" + major + "\0\0\0\0"s + others + std::string(200, '\0');
  };
  std::string dng = "II*\0\x08\0\0\0\x01\0\x12\xc6\x01\0\x04\0\0\0\x01\x04\0\0\0\0\0\0"s;
  const std::pair<std::string, const char*> files[] = {
      {"GIF89a" + std::string(100, 'x'), "GIF"},
      {"\0\0\0\x0cjP  \r\n\x87\n"s, "JPEG 2000"},
      {"\xff\x4f\xff\x51\0\x29"s, "JPEG 2000"},
      {"\0\0\0\x0cJXL \r\n\x87\n"s, "JPEG XL"},
      {"\xff\x0a\xfa\x1f"s, "JPEG XL"},
      {"II+\0\x08\0\0\0"s, "BigTIFF"},
      {"MM\0+\0\x08\0\0"s, "BigTIFF"},
      {dng, "DNG"},
      {brand("avif", "avifmif1miaf"), "AVIF"},
      {brand("mif1", "avifmif1miaf"), "AVIF"},
      {brand("msf1", "msf1hevcmif1"), "sequence"},
      {brand("crx ", "crx isom"), "CR3"},
      {brand("isom", "isomavc1mp42"), "video"},
      {"8BPS\0\1"s, "Photoshop"},
      {"\x89PNG\n\x1a\n"s, "transferred as text"},
      {"\xef\xbb\xbf<!DOCTYPE html><html>"s, "web page"},
      {"<?xml version=\"1.0\"?>\n<svg xmlns"s, "SVG"},
      {"\x93NUMPY\1\0"s, "numpy"},
      {"P2 16 16 255\n0 0"s, "ASCII"},
      {"/9j/4AAQSkZJRgABAQ"s, "base64"},
  };
  for (const auto& [bytes, name] : files) {
    ExpectRefused(Decode(bytes), name);
    ExpectRefused(Decode(bytes), "JPEG, PNG, WebP, BMP, HEIC, PNM, TIFF");
    ExpectRefused(Decode(bytes, ImageLimits()), "reads JPEG, PNG, WebP, BMP, HEIC");
  }
  ExpectRefused(Decode("hello"), "reads JPEG, PNG");
}

TEST(DecodeImage, ImagesOfSixtyFourMillionPixelsAreWithinTheLimit) {
  const std::string bytes = Encode(RandomImage(20, 20, CV_8UC1)).substr(0, 45);
  EXPECT_TRUE(EncodedShape(WithPngSize(bytes, 9248, 6936), kField, ImageLimits()).ok());
  EXPECT_FALSE(EncodedShape(WithPngSize(bytes, 9248, 7936), kField, ImageLimits()).ok());
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

}  // namespace
}  // namespace horopter
