#include "server/vision/matching/plane_following.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <opencv2/core.hpp>

#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

constexpr int kViews = 4;

SyntheticScene Scene() {
  SyntheticSceneOptions options;
  options.views = kViews;
  return MakeSyntheticScene(options);
}

std::vector<cv::Mat> Images(const SyntheticScene& scene, const cv::Mat& texture, double noise) {
  std::vector<cv::Mat> out;
  for (int v = 0; v < kViews; ++v) out.push_back(RenderPlane(scene, v, texture, noise));
  return out;
}

// In the pixels of the first view, all but that `off` pixels wrong.
PlaneInViews RoughPlane(const SyntheticScene& scene, double off) {
  PlaneInViews out(kViews);
  for (int v = 0; v < kViews; ++v) {
    Eigen::Matrix3d D = Eigen::Matrix3d::Identity();
    if (v > 0) D.block<2, 1>(0, 2) = Eigen::Vector2d(v % 2 == 0 ? off : -off, 0.5 * off);
    out[v] = D * (v > 0 ? scene.PlaneHomographyOf(0, v) : Eigen::Matrix3d::Identity());
  }
  return out;
}

class FollowedPlane : public testing::TestWithParam<double> {};

TEST_P(FollowedPlane, LinksEachViewWithTheNextTwo) {
  const SyntheticScene scene = Scene();
  const std::vector<cv::Mat> images = Images(scene, PlaneTexture(3, 15.0), GetParam());
  for (const double off : {0.0, 2.0, 4.0}) {
    const std::vector<PlaneHomography> planes =
        FollowPlane(images, RoughPlane(scene, off), AlignOptions{}, 2);
    ASSERT_EQ(planes.size(), 5u) << off;
    for (const PlaneHomography& p : planes) {
      EXPECT_TRUE(p.view_b == p.view_a + 1 || p.view_b == p.view_a + 2);
      EXPECT_EQ(p.inliers_a.size(), p.inliers_b.size());
      EXPECT_EQ(p.inliers_a.size(), p.information.size());
      EXPECT_LT(WorstTransfer(scene, p.view_a, p.view_b, p.b_from_a), 0.25 + 0.03 * GetParam())
          << p.view_a << " " << p.view_b << " from " << off << " px off";
    }
  }
}
INSTANTIATE_TEST_SUITE_P(NoiseSweep, FollowedPlane, testing::Values(0.0, 2.0, 5.0));

TEST(FollowPlane, IsTheSameWithAnyNumberOfThreads) {
  const SyntheticScene scene = Scene();
  const std::vector<cv::Mat> images = Images(scene, PlaneTexture(5, 15.0), 1.0);
  const auto one = FollowPlane(images, RoughPlane(scene, 2.0), AlignOptions{}, 1);
  const auto four = FollowPlane(images, RoughPlane(scene, 2.0), AlignOptions{}, 4);
  ASSERT_EQ(one.size(), four.size());
  for (std::size_t k = 0; k < one.size(); ++k) EXPECT_EQ(one[k].b_from_a, four[k].b_from_a);
}

TEST(FollowPlane, ViewsWithoutCameraAreLeftOut) {
  const SyntheticScene scene = Scene();
  const std::vector<cv::Mat> images = Images(scene, PlaneTexture(4, 15.0), 1.0);
  PlaneInViews plane = RoughPlane(scene, 1.0);
  plane[1].reset();
  const auto planes = FollowPlane(images, plane, AlignOptions{}, 1);
  ASSERT_EQ(planes.size(), 3u);  // 0 - 2, 0 - 3, 2 - 3
  for (const PlaneHomography& p : planes) EXPECT_NE(p.view_a, 1);
  plane[2].reset();
  plane[3].reset();
  EXPECT_TRUE(FollowPlane(images, plane, AlignOptions{}, 1).empty());
  EXPECT_TRUE(FollowPlane({}, {}, AlignOptions{}, 1).empty());
}

// The camera moves before parts on a turntable, or the ground is blank.
TEST(FollowPlane, WhatMovesElsewhereOrShowsNothingIsNotFollowed) {
  const SyntheticScene scene = Scene();
  const std::vector<cv::Mat> images = Images(scene, PlaneTexture(6, 15.0), 1.0);
  EXPECT_TRUE(FollowPlane(images, RoughPlane(scene, 90.0), AlignOptions{}, 1).empty());
  const std::vector<cv::Mat> blank(kViews, cv::Mat(480, 640, CV_8UC1, cv::Scalar(120)));
  EXPECT_TRUE(FollowPlane(blank, RoughPlane(scene, 0.0), AlignOptions{}, 1).empty());
}

TEST(FollowPlane, AStopIsHonoured) {
  const SyntheticScene scene = Scene();
  const std::vector<cv::Mat> images = Images(scene, PlaneTexture(7, 15.0), 1.0);
  EXPECT_TRUE(
      FollowPlane(images, RoughPlane(scene, 1.0), AlignOptions{}, 2, [] { return true; }).empty());
}

TEST(FollowPlane, ASingularHomographyIsNotFollowed) {
  const SyntheticScene scene = Scene();
  const std::vector<cv::Mat> images = Images(scene, PlaneTexture(8, 15.0), 1.0);
  PlaneInViews plane = RoughPlane(scene, 1.0);
  plane[0] = Eigen::Matrix3d::Zero();  // the plane seen edge on
  for (const PlaneHomography& p : FollowPlane(images, plane, AlignOptions{}, 1))
    EXPECT_GT(p.view_a, 0);
}

}  // namespace
}  // namespace horopter
