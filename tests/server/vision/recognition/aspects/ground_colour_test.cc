#include "server/vision/recognition/aspects/ground_colour.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace horopter {
namespace {

constexpr int kWidth = 480, kHeight = 360;

// Grains of grey under light of the colour `tint`, noise of the sensor on each channel.
cv::Mat Granite(int seed, const cv::Scalar& tint) {
  cv::Mat grains(kHeight, kWidth, CV_32F);
  cv::theRNG().state = static_cast<std::uint64_t>(seed);
  cv::randn(grains, 0.0, 1.0);
  cv::GaussianBlur(grains, grains, cv::Size(), 1.5);
  cv::Scalar mean, deviation;
  cv::meanStdDev(grains, mean, deviation);
  grains.convertTo(grains, CV_8U, 30.0 / deviation[0], 110.0);
  cv::Mat image;
  cv::cvtColor(grains, image, cv::COLOR_GRAY2BGR);
  cv::multiply(image, tint, image);
  return image;
}

void AddNoise(int seed, cv::Mat* image) {
  cv::Mat noise(image->size(), CV_16SC3);
  cv::theRNG().state = static_cast<std::uint64_t>(seed + 1000);
  cv::randn(noise, 0.0, 2.0);
  cv::add(*image, noise, *image, cv::noArray(), CV_8U);
}

// An ellipse with a hole whose brightness is that of the ground.
void Draw(const cv::Scalar& colour, cv::Mat* image) {
  cv::Mat mask(image->size(), CV_8U, cv::Scalar(0));
  cv::ellipse(mask, {240, 180}, {110, 70}, 0, 0, 360, cv::Scalar(255), cv::FILLED);
  cv::ellipse(mask, {240, 180}, {30, 20}, 0, 0, 360, cv::Scalar(0), cv::FILLED);
  image->setTo(colour, mask);
  cv::GaussianBlur(*image, *image, cv::Size(), 0.7);
}

std::vector<Eigen::Vector2f> Ground() {
  std::vector<Eigen::Vector2f> out;
  for (int y = 5; y < kHeight; y += 7) {
    for (int x = 5; x < 110; x += 7) out.emplace_back(x, y);
  }
  return out;
}

// Share of the ellipse's outline with a point within 1.5 px whose normal is within 20 degrees.
double Found(const std::vector<ImageEdgePoint>& edges, float a, float b) {
  int found = 0;
  for (int i = 0; i < 360; ++i) {
    const float t = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / 360;
    const Eigen::Vector2f p(240 + a * std::cos(t), 180 + b * std::sin(t));
    const Eigen::Vector2f n = Eigen::Vector2f(b * std::cos(t), a * std::sin(t)).normalized();
    found += std::any_of(edges.begin(), edges.end(), [&](const ImageEdgePoint& e) {
      return (e.point - p).norm() < 1.5f && std::abs(e.normal.dot(n)) > 0.94f;
    });
  }
  return found / 360.0;
}

class GroundColour : public testing::TestWithParam<int> {};

TEST_P(GroundColour, WhatIsColouredStandsOutFromGreyGrains) {
  for (const cv::Scalar& tint : {cv::Scalar(1.0, 1.0, 1.0), cv::Scalar(0.8, 1.0, 1.1)}) {
    cv::Mat image = Granite(GetParam(), tint);
    Draw(cv::Scalar(160, 95, 60), &image);
    AddNoise(GetParam(), &image);
    const GroundFigure figure = FindColourFigure(image, Ground(), {});
    ASSERT_EQ(figure.width, kWidth);
    EXPECT_TRUE(figure.Inside({170, 180}));
    EXPECT_FALSE(figure.Inside({240, 180}));
    EXPECT_FALSE(figure.Inside({-1, 10}));
    EXPECT_GT(Found(figure.outline, 110, 70), 0.95);
    EXPECT_GT(Found(figure.outline, 30, 20), 0.9);
    EXPECT_LT(figure.outline.size(), 1100u);
    // The image's edges have the outlines as well: the grains do not hide them.
    const AspectImage edges = MakeAspectImage(image);
    EXPECT_GT(Found(edges.edges, 110, 70), 0.9);
  }
}

// Outlines of several kinds may cross a cell that has an edge already.
TEST_P(GroundColour, EdgesAndTheirRasterShareIndices) {
  cv::Mat image = Granite(GetParam(), {1, 1, 1});
  Draw(cv::Scalar(160, 95, 60), &image);
  for (int x = 150; x < 330; x += 12)
    cv::circle(image, {x, 140 + x % 60}, 4, cv::Scalar(120, 60, 30), cv::FILLED);
  AddNoise(GetParam(), &image);
  const AspectImage edges = MakeAspectImage(image);
  int others = 0;
  for (std::size_t i = 0; i < edges.edges.size(); ++i) {
    const Eigen::Vector2f& p = edges.edges[i].point;
    others += edges.edge_at[edges.Cell(static_cast<int>(std::lround(p.x())),
                                       static_cast<int>(std::lround(p.y())))] !=
              static_cast<std::int32_t>(i);
  }
  EXPECT_EQ(others, 0) << "of " << edges.edges.size() << ", seed " << GetParam();
}

TEST_P(GroundColour, GreyThingsDoNot) {
  cv::Mat image = Granite(GetParam(), {1, 1, 1});
  Draw(cv::Scalar::all(60), &image);
  AddNoise(GetParam(), &image);
  const GroundFigure figure = FindColourFigure(image, Ground(), {});
  EXPECT_LT(figure.outline.size(), 60u);
}

INSTANTIATE_TEST_SUITE_P(Seeds, GroundColour, testing::Values(1, 2, 3, 4, 5));

TEST(GroundColourOf, GroundWithoutOneColourNothingDiffers) {
  cv::Mat image(kHeight, kWidth, CV_8UC3);
  for (int x = 0; x < kWidth; x += 20) {
    const cv::Scalar colour = x % 40 == 0 ? cv::Scalar(40, 120, 40) : cv::Scalar(190, 200, 210);
    cv::rectangle(image, {x, 0, 20, kHeight}, colour, cv::FILLED);
  }
  EXPECT_EQ(FindColourFigure(image, Ground(), {}).width, 0);
}

TEST(GroundColourOf, FewPlacesNothingIsSaid) {
  const cv::Mat image = Granite(1, {1, 1, 1});
  EXPECT_EQ(FindColourFigure(image, {{10, 10}, {20, 20}}, {}).width, 0);
  EXPECT_EQ(FindColourFigure({}, Ground(), {}).width, 0);
}

}  // namespace
}  // namespace horopter
