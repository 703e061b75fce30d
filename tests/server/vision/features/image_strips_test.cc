#include "server/vision/features/image_strips.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// Three strips and a bit; `odd`: of a size that no factor divides.
cv::Mat Noise(int type, bool odd) {
  cv::Mat image(odd ? 3137 : 3136, odd ? 1023 : 1024, type);
  cv::RNG random(7);
  random.fill(image, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_16U ? 65536 : 256);
  return image;
}

void ExpectSame(const cv::Mat& a, const cv::Mat& b, const std::string& what) {
  ASSERT_EQ(a.size(), b.size()) << what;
  ASSERT_EQ(a.type(), b.type()) << what;
  EXPECT_EQ(cv::norm(a, b, cv::NORM_INF), 0.0) << what;
}

TEST(ImageStrips, CoverAllRowsOnce) {
  std::vector<int> seen(5000, 0);
  ForEachStrip(
      {3000, 5000},
      [&](const cv::Range& rows) {
        EXPECT_TRUE(rows.size() % 8 == 0 || rows.end == 5000);
        for (int y = rows.start; y < rows.end; ++y) ++seen[y];
      },
      8);
  EXPECT_EQ(seen, std::vector<int>(5000, 1));
}

TEST(ImageStrips, PixelsAreThoseOfTheWholeImage) {
  for (const bool odd : {false, true}) {
    const cv::Mat colour = Noise(CV_8UC3, odd);
    std::vector<cv::Mat> planes, strips;
    cv::split(colour, planes);
    SplitInStrips(colour, &strips);
    ASSERT_EQ(strips.size(), 3u);
    for (int c = 0; c < 3; ++c) ExpectSame(strips[c], planes[c], "split");
    cv::Mat grey, bytes;
    cv::cvtColor(colour, grey, cv::COLOR_BGR2GRAY);
    ExpectSame(RecolourInStrips(colour, cv::COLOR_BGR2GRAY, 1), grey, "grey");
    const cv::Mat deep = Noise(CV_16UC1, odd);
    deep.convertTo(bytes, CV_8U, 255.0 / 65535.0);
    ExpectSame(ConvertInStrips(deep, CV_8U, 255.0 / 65535.0), bytes, "bytes");
    for (const int type : {CV_8UC1, CV_8UC3, CV_32FC1}) {
      const cv::Mat image = Noise(type, odd);
      cv::Mat blurred, reflected;
      cv::GaussianBlur(image, blurred, cv::Size(), 1.2);
      ExpectSame(BlurInStrips(image, cv::Size(), 1.2), blurred, "blur");
      cv::GaussianBlur(image, reflected, cv::Size(7, 7), 5.0, 5.0, cv::BORDER_REFLECT);
      ExpectSame(BlurInStrips(image, {7, 7}, 5.0, cv::BORDER_REFLECT), reflected, "reflected");
    }
    const cv::Mat real = Noise(CV_32FC1, odd);
    cv::Mat shrunk, enlarged;
    cv::resize(real, shrunk, {(real.cols + 3) / 4, (real.rows + 3) / 4}, 0, 0, cv::INTER_AREA);
    ExpectSame(ShrinkInStrips(real, 4), shrunk, "shrunk");
    cv::resize(shrunk, enlarged, real.size(), 0, 0, cv::INTER_LINEAR);
    ExpectSame(EnlargeInStrips(shrunk, 4, real.size()), enlarged, "enlarged");
  }
}

TEST(ImageStrips, OnlyLargeImagesAreShrunkBeforeAndOnlyWhereThatDividesThem) {
  EXPECT_EQ(StripFactor({8160, 6120}, 640.0 / 8160), 6);
  EXPECT_EQ(StripFactor({8161, 6120}, 640.0 / 8161), 1);
  EXPECT_EQ(StripFactor({1280, 960}, 0.125), 1);
}

TEST(ImageStrips, TheWorkMayStopBetweenTwo) {
  int strips = 0;
  const StopRequested after_two = [&] { return strips == 2; };
  const StopScope scope(after_two);
  EXPECT_THROW(ForEachStrip({1024, 10000}, [&](const cv::Range&) { ++strips; }), WorkStopped);
  EXPECT_EQ(strips, 2);
}

}  // namespace
}  // namespace horopter
