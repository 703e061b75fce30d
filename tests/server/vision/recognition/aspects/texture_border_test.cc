#include "server/vision/recognition/aspects/texture_border.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

constexpr int kWidth = 480, kHeight = 360;
constexpr float kPi = std::numbers::pi_v<float>;

// Grains of about `grain_px` whose mean is the grey of what lies on them, which so has no contrast.
cv::Mat Granite(int seed, double grain_px) {
  cv::Mat noise(kHeight, kWidth, CV_32F);
  cv::theRNG().state = static_cast<std::uint64_t>(seed);
  cv::randn(noise, 0.0, 1.0);
  cv::GaussianBlur(noise, noise, cv::Size(), 0.3 * grain_px);
  cv::Scalar mean, deviation;
  cv::meanStdDev(noise, mean, deviation);
  noise.convertTo(noise, CV_8U, 32.0 / deviation[0], 110.0);
  cv::cvtColor(noise, noise, cv::COLOR_GRAY2BGR);
  return noise;
}

void Shade(const cv::Mat& mask, int seed, cv::Mat* image) {
  cv::Mat smooth(image->size(), CV_8UC3, cv::Scalar::all(110));
  smooth.copyTo(*image, mask);
  cv::GaussianBlur(*image, *image, cv::Size(), 0.7);
  cv::Mat noise(image->size(), CV_16SC3);
  cv::theRNG().state = static_cast<std::uint64_t>(seed + 1000);
  cv::randn(noise, 0.0, 1.5);
  cv::add(*image, noise, *image, cv::noArray(), CV_8U);
}

struct OutlinePoint {
  Eigen::Vector2f point, normal;
};

std::vector<OutlinePoint> Ellipse(float a, float b) {
  std::vector<OutlinePoint> out;
  for (int i = 0; i < 360; ++i) {
    const float t = 2 * kPi * static_cast<float>(i) / 360;
    out.push_back({Eigen::Vector2f(240 + a * std::cos(t), 180 + b * std::sin(t)),
                   Eigen::Vector2f(b * std::cos(t), a * std::sin(t)).normalized()});
  }
  return out;
}

// Share of an outline with an edge within 2 px whose direction is within 20 degrees.
double Found(const AspectImage& image, const std::vector<OutlinePoint>& outline) {
  int found = 0;
  for (const OutlinePoint& o : outline) {
    found += std::any_of(image.edges.begin(), image.edges.end(), [&](const ImageEdgePoint& e) {
      return (e.point - o.point).norm() < 2.0f && std::abs(e.normal.dot(o.normal)) > 0.94f;
    });
  }
  return static_cast<double>(found) / static_cast<double>(outline.size());
}

class TextureBorders : public testing::TestWithParam<int> {};

TEST_P(TextureBorders, OutlineASmoothThingOnGranite) {
  const auto outline = Ellipse(110, 70);
  for (const double grain_px : {4.0, 6.0}) {
    cv::Mat image = Granite(GetParam(), grain_px);
    cv::Mat mask(image.size(), CV_8U, cv::Scalar(0));
    cv::ellipse(mask, {240, 180}, {110, 70}, 0, 0, 360, cv::Scalar(255), cv::FILLED);
    Shade(mask, GetParam(), &image);
    const AspectImage edges = MakeAspectImage(image);
    EXPECT_GT(Found(edges, outline), 0.85) << "grains of " << grain_px;
    int inside = 0;
    for (const ImageEdgePoint& e : edges.edges) {
      const float x = (e.point.x() - 240) / 110, y = (e.point.y() - 180) / 70;
      inside += x * x + y * y < 0.8f;
    }
    EXPECT_EQ(inside, 0);
    EXPECT_LT(edges.edges.size(), 3000u) << "grains of " << grain_px;
  }
}

TEST_P(TextureBorders, AreNotWhereNothingIsSmooth) {
  const AspectImage edges = MakeAspectImage(Granite(GetParam(), 4.0));
  EXPECT_LT(edges.edges.size(), 600u);
}

INSTANTIATE_TEST_SUITE_P(Seeds, TextureBorders, testing::Values(1, 2, 3, 4, 5));

TEST(TextureBorder, IsEmptyWithoutTexture) {
  cv::Mat image(kHeight, kWidth, CV_8UC3, cv::Scalar::all(90));
  cv::rectangle(image, {100, 80, 200, 150}, cv::Scalar::all(180), cv::FILLED);
  const AspectImage edges = MakeAspectImage(image);
  ASSERT_GT(edges.edges.size(), 500u);
  EXPECT_TRUE(TextureBorder(edges, std::vector<std::uint8_t>(edges.edges.size(), 0), {}).empty());
}

}  // namespace
}  // namespace horopter
