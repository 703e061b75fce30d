#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "horopter/v1/recognition.pb.h"
#include "server/service/image_decode.h"
#include "server/service/rpc_status.h"
#include "tests/server/service/image_samples.h"

namespace horopter {
namespace {

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

// The colour of one pixel of a mosaic: 0 red, 1 green, 2 blue.
int MosaicColour(const std::string& order, int x, int y) {
  return static_cast<int>(std::string("RGB").find(order[static_cast<size_t>(2 * (y % 2) + x % 2)]));
}

TEST(RawFrames, MosaicsOfAllOrdersAndDepthsGiveTheirColour) {
  const std::tuple<std::string, v1::RawFrame::PixelFormat, v1::RawFrame::PixelFormat> mosaics[] = {
      {"RGGB", v1::RawFrame::PIXEL_FORMAT_BAYER_RG8, v1::RawFrame::PIXEL_FORMAT_BAYER_RG16},
      {"BGGR", v1::RawFrame::PIXEL_FORMAT_BAYER_BG8, v1::RawFrame::PIXEL_FORMAT_BAYER_BG16},
      {"GBRG", v1::RawFrame::PIXEL_FORMAT_BAYER_GB8, v1::RawFrame::PIXEL_FORMAT_BAYER_GB16},
      {"GRBG", v1::RawFrame::PIXEL_FORMAT_BAYER_GR8, v1::RawFrame::PIXEL_FORMAT_BAYER_GR16}};
  const int colour[3] = {200, 90, 30};  // red, green, blue
  for (const auto& [order, format8, format16] : mosaics) {
    cv::Mat narrow(20, 30, CV_8UC1), wide(20, 30, CV_16UC1);
    for (int y = 0; y < 20; ++y) {
      for (int x = 0; x < 30; ++x) {
        const int value = colour[MosaicColour(order, x, y)];
        narrow.at<uchar>(y, x) = static_cast<uchar>(value);
        wide.at<uint16_t>(y, x) = static_cast<uint16_t>(value * 4095 / 255);
      }
    }
    v1::RawFrame twelve = Frame(format16, 30, 20, wide);
    twelve.set_bits_in_use(12);
    for (const v1::RawFrame& frame : {Frame(format8, 30, 20, narrow), twelve}) {
      const auto decoded = DecodeRaw(frame);
      ASSERT_TRUE(decoded.ok()) << decoded.status();
      const cv::Vec3b pixel = (*decoded)[0].at<cv::Vec3b>(10, 14);
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(pixel[2 - c], colour[c], 1) << order << " " << c;
    }
  }
}

TEST(RawFrames, SixteenBitsAreScaledByThoseInUse) {
  const cv::Mat grey = RandomImage(20, 31, CV_8UC1);
  for (const int bits : {8, 10, 12, 14, 16}) {
    cv::Mat wide;
    grey.convertTo(wide, CV_16U, ((1 << bits) - 1) / 255.0);
    v1::RawFrame frame = Frame(v1::RawFrame::PIXEL_FORMAT_GRAY16, 31, 20, wide);
    for (const int told : {0, bits}) {
      frame.set_bits_in_use(told);
      const auto decoded = DecodeRaw(frame);
      ASSERT_TRUE(decoded.ok()) << decoded.status();
      EXPECT_EQ((*decoded)[0].type(), CV_8UC1);
      EXPECT_LE(cv::norm((*decoded)[0], grey, cv::NORM_INF), 1.0) << bits;
    }
    // A row of an odd number of bytes.
    frame.set_stride_bytes(63);
    std::string padded;
    for (int y = 0; y < 20; ++y)
      padded += frame.data().substr(static_cast<size_t>(62 * y), 62) + "!";
    frame.set_data(padded);
    EXPECT_LE(cv::norm((*DecodeRaw(frame))[0], grey, cv::NORM_INF), 1.0) << bits;
  }
  // A dark image of a camera of 12 bits stays dark where its bits are told.
  v1::RawFrame dark =
      Frame(v1::RawFrame::PIXEL_FORMAT_GRAY16, 31, 20, cv::Mat(20, 31, CV_16UC1, cv::Scalar(160)));
  dark.set_bits_in_use(12);
  EXPECT_EQ((*DecodeRaw(dark))[0].at<uchar>(3, 3), 10);
  dark.set_bits_in_use(8);  // more than is said: saturated
  dark.mutable_data()->assign(dark.data().size(), '\xff');
  EXPECT_EQ((*DecodeRaw(dark))[0].at<uchar>(3, 3), 255);
}

TEST(RawFrames, YuvOfEveryOrderBecomesItsColour) {
  const int yuv[3] = {81, 90, 240};  // BT.601's red
  const auto check = [&](v1::RawFrame::PixelFormat format, const cv::Mat& rows) {
    const auto decoded = DecodeRaw(Frame(format, 30, 20, rows));
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    ASSERT_EQ((*decoded)[0].size(), cv::Size(30, 20));
    const cv::Vec3b pixel = (*decoded)[0].at<cv::Vec3b>(10, 15);
    EXPECT_NEAR(pixel[0], 0, 3);
    EXPECT_NEAR(pixel[1], 0, 3);
    EXPECT_NEAR(pixel[2], 255, 3);
  };
  cv::Mat uyvy(20, 60, CV_8UC1), yuyv(20, 60, CV_8UC1), nv21(30, 30, CV_8UC1, cv::Scalar(yuv[0]));
  for (int y = 0; y < 20; ++y) {
    for (int x = 0; x < 60; ++x) {
      const int colour = x % 4 < 2 ? yuv[1] : yuv[2];
      uyvy.at<uchar>(y, x) = static_cast<uchar>(x % 2 == 1 ? yuv[0] : colour);
      yuyv.at<uchar>(y, x) = static_cast<uchar>(x % 2 == 0 ? yuv[0] : colour);
    }
  }
  for (int y = 20; y < 30; ++y) {
    for (int x = 0; x < 30; ++x)
      nv21.at<uchar>(y, x) = static_cast<uchar>(x % 2 == 0 ? yuv[2] : yuv[1]);
  }
  check(v1::RawFrame::PIXEL_FORMAT_UYVY, uyvy);
  check(v1::RawFrame::PIXEL_FORMAT_YUYV, yuyv);
  check(v1::RawFrame::PIXEL_FORMAT_NV21, nv21);
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
  const auto with_format = [&](v1::RawFrame::PixelFormat format, int width) {
    return field([&](auto& f) {
      f.set_format(format);
      f.set_width_px(width);
    });
  };
  EXPECT_EQ(with_format(v1::RawFrame::PIXEL_FORMAT_UYVY, 15), "images[0].raw.format");
  EXPECT_EQ(with_format(v1::RawFrame::PIXEL_FORMAT_BAYER_GB16, 15), "images[0].raw.format");
  EXPECT_EQ(with_format(v1::RawFrame::PIXEL_FORMAT_GRAY16, 30), "images[0].raw.stride_bytes");
  EXPECT_EQ(field([](auto& f) { f.set_bits_in_use(12); }), "images[0].raw.bits_in_use");
  EXPECT_EQ(field([](auto& f) {
              f.set_format(v1::RawFrame::PIXEL_FORMAT_GRAY16);
              f.set_width_px(15);
              f.set_bits_in_use(17);
            }),
            "images[0].raw.bits_in_use");
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
