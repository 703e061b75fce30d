#include "server/vision/recognition/aspects/contour_ellipses.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

cv::Mat Ground() {
  return {480, 640, CV_8UC3, cv::Scalar(190, 190, 190)};
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
