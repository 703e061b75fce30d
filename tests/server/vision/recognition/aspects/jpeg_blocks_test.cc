#include "server/vision/recognition/aspects/jpeg_blocks.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

// A table in slanting light with a little grain, and a dark bar on it.
cv::Mat Table(int bar_from, double noise = 2.0) {
  cv::Mat image(240, 320, CV_8UC3);
  cv::RNG random(3);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double light = 120 + 0.25 * x + 0.1 * y + random.gaussian(noise);
      image.at<cv::Vec3b>(y, x) = cv::Vec3b::all(cv::saturate_cast<std::uint8_t>(light));
    }
  }
  image(cv::Rect(bar_from, 60, 96, 120)) = cv::Scalar::all(60);
  return image;
}

cv::Mat Compressed(const cv::Mat& image, int quality) {
  std::vector<std::uint8_t> bytes;
  cv::imencode(".jpg", image, bytes, {cv::IMWRITE_JPEG_QUALITY, quality});
  return cv::imdecode(bytes, cv::IMREAD_COLOR);
}

// Edge points off the bar's outline.
int EdgesOffTheBar(const cv::Mat& image, const cv::Rect& bar, bool jpeg_blocks) {
  AspectImageOptions options;
  options.jpeg_blocks = jpeg_blocks;
  int off = 0;
  const AspectImage seen = MakeAspectImage(image, options);
  for (const ImageEdgePoint& e : seen.edges) {
    const Eigen::Vector2d at = OriginalPixel(seen, e.point.cast<double>());
    const cv::Rect near(bar.x - 9, bar.y - 9, bar.width + 18, bar.height + 18);
    off += !near.contains({static_cast<int>(at.x()), static_cast<int>(at.y())});
  }
  return off;
}

TEST(JpegBlocks, AreToldFromImagesThatHaveNone) {
  const cv::Mat image = Table(101);
  EXPECT_LT(Blockiness(image), 0.2);
  EXPECT_GT(Blockiness(Compressed(image, 40)), 1.0);
  EXPECT_GT(Blockiness(Compressed(image, 20)), Blockiness(Compressed(image, 60)));
  // Cut out off the grid there is no grid to go by.
  EXPECT_LT(Blockiness(Compressed(image, 40)(cv::Rect(3, 5, 300, 200))), 0.3);
  cv::Mat grey;
  cv::cvtColor(Compressed(image, 40), grey, cv::COLOR_BGR2GRAY);
  EXPECT_GT(Blockiness(grey), 1.0);
}

TEST(JpegBlocks, ImagesWithoutThemStayAsTheyAre) {
  const cv::Mat image = Table(101);
  EXPECT_EQ(WithoutBlocks(image).image.data, image.data);
  EXPECT_TRUE(WithoutBlocks(cv::Mat()).image.empty());
}

TEST(JpegBlocks, WhatQuantisationMakesIsNoEdge) {
  const cv::Mat blocky = Compressed(Table(101, 5.0), 30);
  const cv::Rect bar(101, 60, 96, 120);
  const int before = EdgesOffTheBar(blocky, bar, false);
  ASSERT_GT(before, 200);
  EXPECT_LT(EdgesOffTheBar(blocky, bar, true), before / 2);
}

TEST(JpegBlocks, AnEdgeOnTheGridStays) {
  const cv::Mat blocky = Compressed(Table(104), 40);  // its sides lie between blocks
  const cv::Mat smooth = WithoutBlocks(blocky).image;
  ASSERT_NE(smooth.data, blocky.data);
  for (int y = 90; y < 150; ++y) {
    const int step = smooth.at<cv::Vec3b>(y, 103)[1] - smooth.at<cv::Vec3b>(y, 104)[1];
    const int was = blocky.at<cv::Vec3b>(y, 103)[1] - blocky.at<cv::Vec3b>(y, 104)[1];
    EXPECT_GT(step, was - 8) << y;
  }
}

}  // namespace
}  // namespace horopter
