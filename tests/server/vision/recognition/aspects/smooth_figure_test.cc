#include "server/vision/recognition/aspects/smooth_figure.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace horopter {
namespace {

constexpr int kWidth = 480, kHeight = 360;

// Grey grains, darker to the right as in a shadow.
cv::Mat Granite(int seed, bool shaded) {
  cv::Mat grains(kHeight, kWidth, CV_32F);
  cv::theRNG().state = static_cast<std::uint64_t>(seed);
  cv::randn(grains, 0.0, 1.0);
  cv::GaussianBlur(grains, grains, cv::Size(), 1.5);
  cv::Scalar mean, deviation;
  cv::meanStdDev(grains, mean, deviation);
  grains.convertTo(grains, CV_32F, 30.0 / deviation[0], 110.0);
  if (shaded) grains.colRange(360, kWidth) *= 0.4;
  cv::Mat image;
  grains.convertTo(image, CV_8U);
  cv::cvtColor(image, image, cv::COLOR_GRAY2BGR);
  return image;
}

// An ellipse with a hole.
cv::Mat PartMask() {
  cv::Mat mask(kHeight, kWidth, CV_8U, cv::Scalar(0));
  cv::ellipse(mask, {240, 180}, {110, 70}, 0, 0, 360, cv::Scalar(255), cv::FILLED);
  cv::ellipse(mask, {240, 180}, {30, 20}, 0, 0, 360, cv::Scalar(0), cv::FILLED);
  return mask;
}

// With a groove in it.
void Draw(int level, cv::Mat* image) {
  image->setTo(cv::Scalar::all(level), PartMask());
  cv::line(*image, {140, 180}, {205, 180}, cv::Scalar::all(level / 2), 1);
  cv::GaussianBlur(*image, *image, cv::Size(), 0.7);
}

void AddNoise(int seed, cv::Mat* image) {
  cv::Mat noise(image->size(), CV_16SC3);
  cv::theRNG().state = static_cast<std::uint64_t>(seed + 1000);
  cv::randn(noise, 0.0, 2.0);
  cv::add(*image, noise, *image, cv::noArray(), CV_8U);
}

std::vector<Eigen::Vector2f> Ground() {
  std::vector<Eigen::Vector2f> out;
  for (int y = 5; y < kHeight; y += 2) {
    for (int x = 5; x < 110; x += 2) out.emplace_back(x, y);
  }
  return out;
}

// Share of the ellipse's outline with a point so near whose normal is within 20 degrees.
double Found(const std::vector<ImageEdgePoint>& edges, float a, float b, float near_px) {
  int found = 0;
  for (int i = 0; i < 360; ++i) {
    const float t = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / 360;
    const Eigen::Vector2f p(240 + a * std::cos(t), 180 + b * std::sin(t));
    const Eigen::Vector2f n = Eigen::Vector2f(b * std::cos(t), a * std::sin(t)).normalized();
    found += std::any_of(edges.begin(), edges.end(), [&](const ImageEdgePoint& e) {
      return (e.point - p).norm() < near_px && std::abs(e.normal.dot(n)) > 0.94f;
    });
  }
  return found / 360.0;
}

class SmoothFigureOf : public testing::TestWithParam<int> {};

// Share of cells that are inside, of those on the part or on the ground, some px from its outline.
double ShareInside(const GroundFigure& figure, bool of_model) {
  cv::Mat mask = PartMask();
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, {13, 13});
  of_model ? cv::erode(mask, mask, disc) : cv::dilate(mask, mask, disc);
  int all = 0, inside = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if ((mask.at<std::uint8_t>(y, x) != 0) != of_model) continue;
      ++all;
      inside += figure.Inside({static_cast<float>(x), static_cast<float>(y)});
    }
  }
  return static_cast<double>(inside) / all;
}

// Darker than the ground, of its mean brightness, and lighter.
TEST_P(SmoothFigureOf, PartsOfAnyBrightnessStandOutFromGrains) {
  for (const int level : {30, 110, 210}) {
    SCOPED_TRACE(testing::Message() << "seed " << GetParam() << " level " << level);
    cv::Mat image = Granite(GetParam(), false);
    Draw(level, &image);
    AddNoise(GetParam(), &image);
    const GroundFigure figure = FindSmoothFigure(image, Ground(), {});
    ASSERT_EQ(figure.width, kWidth);
    EXPECT_GT(ShareInside(figure, true), 0.95);
    EXPECT_LT(ShareInside(figure, false), 0.03);
    EXPECT_FALSE(figure.Inside({-1, 10}));
    const AspectImage edges = MakeAspectImage(image);
    EXPECT_GT(Found(edges.edges, 110, 70, 3.0f), level == 110 ? 0.4 : 0.8);
    if (level < 100) continue;  // the groove of a dark part is as faint as the noise
    const auto of_groove = std::count_if(edges.edges.begin(), edges.edges.end(), [](const auto& e) {
      return std::abs(e.point.y() - 180) < 3 && e.point.x() > 150 && e.point.x() < 200 &&
             std::abs(e.normal.y()) > 0.9f;
    });
    EXPECT_GT(of_groove, 40);
  }
}

TEST_P(SmoothFigureOf, AShadowIsNone) {
  cv::Mat image = Granite(GetParam(), true);
  AddNoise(GetParam(), &image);
  const GroundFigure figure = FindSmoothFigure(image, Ground(), {});
  const auto inside = std::count(figure.inside.begin(), figure.inside.end(), 1);
  EXPECT_LT(inside, kWidth * kHeight / 100) << "seed " << GetParam();
}

INSTANTIATE_TEST_SUITE_P(Seeds, SmoothFigureOf, testing::Values(1, 2, 3, 4, 5));

TEST(SmoothFigure, GroundWithoutGrainNothingIsSaid) {
  const cv::Mat plain(kHeight, kWidth, CV_8UC3, cv::Scalar::all(120));
  EXPECT_EQ(FindSmoothFigure(plain, Ground(), {}).width, 0);
}

TEST(SmoothFigure, FewPlacesNothingIsSaid) {
  EXPECT_EQ(FindSmoothFigure(Granite(1, false), {{10, 10}, {20, 20}}, {}).width, 0);
  EXPECT_EQ(FindSmoothFigure({}, Ground(), {}).width, 0);
}

}  // namespace
}  // namespace horopter
