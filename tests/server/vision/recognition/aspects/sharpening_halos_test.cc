#include "server/vision/recognition/aspects/sharpening_halos.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "server/vision/recognition/aspects/edge_pixels.h"

namespace horopter {
namespace {

// Bright and dark discs on a grey table, blurred as a lens does.
cv::Mat Discs() {
  cv::Mat image(360, 480, CV_8UC3, cv::Scalar::all(128));
  cv::circle(image, {120, 180}, 70, cv::Scalar::all(225), cv::FILLED, cv::LINE_AA);
  cv::circle(image, {340, 180}, 80, cv::Scalar::all(30), cv::FILLED, cv::LINE_AA);
  cv::GaussianBlur(image, image, {}, 1.0);
  return image;
}

cv::Mat Sharpened(const cv::Mat& image) {
  cv::Mat smooth, out;
  cv::GaussianBlur(image, smooth, {}, 2.0);
  cv::addWeighted(image, 2.5, smooth, -1.5, 0.0, out);
  return out;
}

std::vector<ImageEdgePoint> Edges(const cv::Mat& image) {
  AspectImageOptions options;
  options.noise_factor = 0.0;
  return DetectEdgePoints(image, options);
}

// Points farther than this from both outlines.
int Off(const std::vector<ImageEdgePoint>& edges, double px) {
  int off = 0;
  for (const ImageEdgePoint& e : edges) {
    const double a = std::abs((e.point - Eigen::Vector2f(120, 180)).norm() - 70.0f);
    const double b = std::abs((e.point - Eigen::Vector2f(340, 180)).norm() - 80.0f);
    off += std::min(a, b) > px;
  }
  return off;
}

TEST(SharpeningHalos, AreToldByWhatEdgesOvershoot) {
  EXPECT_LT(Overshoot(Discs(), Edges(Discs())), 0.01);
  EXPECT_GT(Overshoot(Sharpened(Discs()), Edges(Sharpened(Discs()))), 0.08);
  EXPECT_EQ(Overshoot(cv::Mat(60, 60, CV_8UC3, cv::Scalar::all(9)), {}), 0.0);
}

TEST(SharpeningHalos, TheWayBackIsNoEdge) {
  const cv::Mat sharp = Sharpened(Discs());
  std::vector<ImageEdgePoint> edges = Edges(sharp);
  const int before = Off(edges, 1.5), on_before = static_cast<int>(edges.size()) - before;
  ASSERT_GT(before, 200);
  DropHalos(sharp, &edges);
  EXPECT_LT(Off(edges, 1.5), before / 3);
  EXPECT_GT(static_cast<int>(edges.size()) - Off(edges, 1.5), 0.97 * on_before)
      << "the edges themselves stay";
}

TEST(SharpeningHalos, ImagesAsLensesMakeThemKeepEveryEdge) {
  std::vector<ImageEdgePoint> edges = Edges(Discs());
  const std::size_t before = edges.size();
  DropHalos(Discs(), &edges);
  EXPECT_EQ(edges.size(), before);
}

// A thin frame has two edges side by side, of one strength.
TEST(SharpeningHalos, ThinThingsStay) {
  cv::Mat image = Discs();
  cv::rectangle(image, {20, 20, 60, 60}, cv::Scalar::all(190), 5, cv::LINE_AA);
  const cv::Mat sharp = Sharpened(image);
  std::vector<ImageEdgePoint> edges = Edges(sharp);
  const auto in_frame = [&] {
    int n = 0;
    for (const ImageEdgePoint& e : edges)
      n += e.strength > 12.0f && e.point.x() < 90 && e.point.y() < 90;
    return n;
  };
  const int before = in_frame();
  ASSERT_GT(before, 300);
  DropHalos(sharp, &edges);
  EXPECT_GT(in_frame(), 0.95 * before);
}

}  // namespace
}  // namespace horopter
