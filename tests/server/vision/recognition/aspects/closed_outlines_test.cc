#include "server/vision/recognition/aspects/closed_outlines.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "server/vision/recognition/aspects/outline_shape.h"

namespace horopter {
namespace {

cv::Mat Ground() {
  return {480, 640, CV_8UC3, cv::Scalar(190, 190, 190)};
}

TEST(ClosedOutlines, WhatStandsAloneIsEnclosedLargestFirst) {
  cv::Mat picture = Ground();
  const std::vector<cv::Point> wedge{{100, 100}, {300, 140}, {260, 300}, {120, 260}};
  cv::fillConvexPoly(picture, wedge, cv::Scalar(60, 60, 60), cv::LINE_AA);
  cv::circle(picture, {480, 200}, 50, cv::Scalar(90, 60, 40), cv::FILLED, cv::LINE_AA);
  cv::line(
      picture, {10, 460}, {600, 400}, cv::Scalar(40, 40, 40), 3, cv::LINE_AA);  // encloses none
  const auto outlines = FindClosedOutlines(MakeAspectImage(picture));
  ASSERT_EQ(outlines.size(), 2u);
  std::vector<Eigen::Vector2f> corners;
  for (const cv::Point& p : wedge) corners.emplace_back(p.x, p.y);
  const auto found = ShapeOf(outlines[0]), drawn = ShapeOf(corners);
  ASSERT_TRUE(found && drawn);
  EXPECT_LT((found->center - drawn->center).norm(), 1.5f);
  EXPECT_NEAR(found->width, drawn->width, 4.0f);
  const auto turn = TurnsBetween(*drawn, *found, 1).front();
  EXPECT_NEAR(std::remainder(turn.turn_rad, 6.283185307), 0.0, 0.03);
  EXPECT_LT(turn.apart, 0.02f);
  const auto disc = ShapeOf(outlines[1]);
  ASSERT_TRUE(disc);
  EXPECT_LT((disc->center - Eigen::Vector2f(480, 200)).norm(), 1.5f);
}

TEST(ClosedOutlines, WhatTheBorderCutsAndWhatIsOpenIsNone) {
  cv::Mat picture = Ground();
  cv::circle(picture, {0, 240}, 120, cv::Scalar(60, 60, 60), cv::FILLED, cv::LINE_AA);
  cv::ellipse(picture, {400, 240}, {90, 60}, 0, 0, 250, cv::Scalar(60, 60, 60), 1, cv::LINE_AA);
  EXPECT_TRUE(FindClosedOutlines(MakeAspectImage(picture)).empty());
  EXPECT_TRUE(FindClosedOutlines(MakeAspectImage(Ground())).empty());
  EXPECT_TRUE(FindClosedOutlines({}).empty());
}

TEST(ContourEllipses, RimsAreFoundCornersAreNot) {
  cv::Mat picture = Ground();
  cv::ellipse(
      picture, {200, 200}, {90, 50}, 20, 0, 360, cv::Scalar(50, 50, 50), cv::FILLED, cv::LINE_AA);
  cv::rectangle(picture, {400, 100}, {560, 220}, cv::Scalar(50, 50, 50), cv::FILLED);
  const auto ellipses = FindContourEllipses(MakeAspectImage(picture).contours);
  ASSERT_EQ(ellipses.size(), 1u);
  EXPECT_LT((ellipses[0].center - Eigen::Vector2d(200, 200)).norm(), 0.5);
  EXPECT_NEAR(ellipses[0].semi_major_px, 90.0, 1.0);
  EXPECT_NEAR(ellipses[0].semi_minor_px, 50.0, 1.0);
  EXPECT_NEAR(std::remainder(ellipses[0].angle_rad - 20 * CV_PI / 180, CV_PI), 0.0, 0.01);
  EXPECT_TRUE(FindContourEllipses({}).empty());
}

}  // namespace
}  // namespace horopter
