#include "server/vision/matching/ground_motion.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <opencv2/imgproc.hpp>

#include "server/vision/matching/homography.h"
#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

Eigen::Matrix3d ImageFromPicture(int v) {
  Eigen::Matrix3d H;
  H << 1.0 - 0.02 * v, 0.03 * v, -300.0 - 12.0 * v, -0.03 * v, 1.0 + 0.01 * v, -400.0 + 9.0 * v,
      1e-5 * v, -2e-5 * v, 1.0;
  return H;
}

cv::Mat View(int v, const cv::Mat& picture) {
  cv::Matx33d M;
  const Eigen::Matrix3d H = ImageFromPicture(v);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) M(r, c) = H(r, c);
  }
  cv::Mat image, wide, noise(480, 640, CV_32FC1);
  cv::warpPerspective(picture, image, M, noise.size(), cv::INTER_LINEAR, cv::BORDER_REFLECT);
  cv::RNG(v + 1).fill(noise, cv::RNG::NORMAL, 0.0, 1.0);
  image.convertTo(wide, CV_32F);
  wide += noise;
  wide.convertTo(image, CV_8U);
  return image;
}

cv::Mat Picture(int seed) {
  cv::Mat picture;
  cv::resize(PlaneTexture(seed, 15.0), picture, cv::Size(1300, 1300), 0, 0, cv::INTER_CUBIC);
  return picture;
}

std::vector<cv::Mat> Views(int count, const cv::Mat& picture) {
  std::vector<cv::Mat> out;
  for (int v = 0; v < count; ++v) out.push_back(View(v, picture));
  return out;
}

TEST(FindGround, TakesPointsOfTheGroundFromViewToView) {
  const PlaneInViews ground = FindGround(Views(4, Picture(3)), {});
  ASSERT_EQ(ground.size(), 4u);
  for (int v = 0; v < 4; ++v) ASSERT_TRUE(ground[v].has_value()) << v;
  for (int v = 1; v < 4; ++v) {
    const Eigen::Matrix3d found = *ground[v] * ground[0]->inverse();
    const Eigen::Matrix3d truth = ImageFromPicture(v) * ImageFromPicture(0).inverse();
    for (const double x : {150.0, 320.0, 500.0}) {
      for (const double y : {120.0, 240.0, 400.0})
        EXPECT_LT((Transfer(found, {x, y}) - Transfer(truth, {x, y})).norm(), 0.5);
    }
  }
}

TEST(FindGround, TwoViewsSayNothing) {
  const PlaneInViews ground = FindGround(Views(2, Picture(4)), {});
  EXPECT_EQ(ground, PlaneInViews(2));
}

TEST(FindGround, OtherPicturesAreNotLinked) {
  std::vector<cv::Mat> images;
  for (int v = 0; v < 3; ++v) images.push_back(View(v, Picture(20 + v)));
  EXPECT_EQ(FindGround(images, {}), PlaneInViews(3));
}

// A view of something else is left out of it.
TEST(FindGround, TheOddViewIsNotLinked) {
  std::vector<cv::Mat> images = Views(4, Picture(5));
  images[2] = View(2, Picture(30));
  const PlaneInViews ground = FindGround(images, {});
  EXPECT_TRUE(ground[0] && ground[1] && ground[3]);
  EXPECT_FALSE(ground[2].has_value());
}

TEST(FindGround, StopsWhenAsked) {
  EXPECT_EQ(FindGround(Views(3, Picture(6)), {}, [] { return true; }), PlaneInViews(3));
}

TEST(LargestPlane, IsTheComponentOfMostViews) {
  MatchingResult matching;
  matching.component = {0, 1, 1, 0, 1, -1};
  matching.view_from_plane.assign(6, Eigen::Matrix3d::Identity());
  matching.view_from_plane[4](0, 2) = 7.0;
  const PlaneInViews plane = LargestPlane(matching);
  ASSERT_EQ(plane.size(), 6u);
  EXPECT_TRUE(plane[1] && plane[2] && plane[4]);
  EXPECT_FALSE(plane[0] || plane[3] || plane[5]);
  EXPECT_EQ((*plane[4])(0, 2), 7.0);
  matching.component = {0, 0, 1, 1, -1, -1};
  EXPECT_EQ(LargestPlane(matching), PlaneInViews(6));
}

}  // namespace
}  // namespace horopter
