#include "server/service/rectify.h"

#include <gtest/gtest.h>

#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

// Dots of a grid as a camera with this lens sees them.
cv::Mat DotsThrough(const LensModel& lens, int rows, int cols) {
  cv::Mat_<float> image(rows, cols, 0.0f);
  for (int v = 0; v < rows; ++v) {
    for (int u = 0; u < cols; ++u) {
      double sum = 0.0;
      for (int i = -6; i <= 6; ++i) {
        for (int j = -4; j <= 4; ++j) {
          const Eigen::Vector2d dot = DistortedPixel(lens, {0.08 * i, 0.08 * j});
          sum += std::exp(-0.125 * (dot - Eigen::Vector2d(u, v)).squaredNorm());
        }
      }
      image(v, u) = static_cast<float>(std::min(1.0, sum));
    }
  }
  cv::Mat out;
  image.convertTo(out, CV_8U, 255.0);
  return out;
}

// Centre of gravity of what is bright about a place.
Eigen::Vector2d CentreAbout(const cv::Mat& image, const Eigen::Vector2d& place) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double weight = 0.0;
  for (int dv = -7; dv <= 7; ++dv) {
    for (int du = -7; du <= 7; ++du) {
      const int u = static_cast<int>(std::lround(place.x())) + du;
      const int v = static_cast<int>(std::lround(place.y())) + dv;
      const double w = image.at<unsigned char>(v, u);
      sum += w * Eigen::Vector2d(u, v);
      weight += w;
    }
  }
  return sum / weight;
}

TEST(Rectify, APinholeCameraSeesTheDotsWhereTheirRaysAre) {
  LensModel brown{LensModel::Kind::kPlumbBob, 300.0, 330.0, 162.0, 118.0, {}};
  brown.coefficients = {-0.3, 0.1, 0.002, -0.003, 0.01};
  LensModel fisheye{LensModel::Kind::kEquidistant, 300.0, 300.0, 158.0, 121.0, {}};
  fisheye.coefficients = {0.05, -0.01, 0.002, 0.0, 0.0};
  LensModel rational{LensModel::Kind::kPlumbBob, 300.0, 300.0, 160.0, 120.0, {}};
  rational.coefficients = {0.31, -0.15, 0.0002, 0.0001, 0.01};
  rational.denominator = {0.63, -0.16, 0.012};
  for (const LensModel& lens : {brown, fisheye, rational}) {
    const auto rectified = Rectified(DotsThrough(lens, 240, 320), lens);
    ASSERT_TRUE(rectified.ok()) << rectified.status();
    double worst = 0.0;
    for (int i = -5; i <= 5; ++i) {
      for (int j = -3; j <= 3; ++j) {
        const Eigen::Vector2d expected(lens.fx * 0.08 * i + lens.cx, lens.fx * 0.08 * j + lens.cy);
        worst = std::max(worst, (CentreAbout(*rectified, expected) - expected).norm());
      }
    }
    EXPECT_LT(worst, 0.2);  // pixels; the image that was sent has them up to 10 off
  }
}

// Beyond the radius where the lens turns back the image's rim is repeated, not its inside.
TEST(Rectify, WhatTheLensDidNotSeeIsNotTheImageOnceMore) {
  LensModel lens{LensModel::Kind::kPlumbBob, 100.0, 100.0, 99.5, 99.5, {}};
  lens.coefficients = {0.4, -0.35, 0.0, 0.0, 0.0};
  const LensReach reach = ReachOf(lens);
  ASSERT_LT(reach.ray, 0.5 * 199 / lens.fx * std::sqrt(2.0));
  cv::Mat image(200, 200, CV_8UC1, cv::Scalar(0));
  cv::circle(image, {100, 100}, static_cast<int>(100.0 * reach.image) - 6, cv::Scalar(255), -1);
  const auto out = Rectified(image, lens);
  ASSERT_TRUE(out.ok());
  for (const int k : {0, 2, 4}) EXPECT_EQ(out->at<unsigned char>(k, k), 0) << k;
}

TEST(Rectify, TypeAndSizeStayAndNoLensIsTooOdd) {
  const cv::Mat image(40, 60, CV_8UC3, cv::Scalar(10, 20, 30));
  for (const double odd : {-10.0, 10.0}) {
    for (const double centre : {0.0, 1e300, -1e300, std::numeric_limits<double>::max()}) {
      LensModel lens{LensModel::Kind::kPlumbBob, 1e-3, 1e-3, centre, centre, {}};
      lens.coefficients.fill(odd);
      const auto out = Rectified(image, lens);
      ASSERT_TRUE(out.ok()) << out.status();
      EXPECT_EQ(out->size(), image.size());
      EXPECT_EQ(out->type(), image.type());
    }
  }
}

}  // namespace
}  // namespace horopter
