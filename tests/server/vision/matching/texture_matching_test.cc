#include "server/vision/matching/texture_matching.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <set>

#include "server/vision/geometry/fundamental_matrix.h"
#include "tests/support/textured_scene.h"

namespace horopter {
namespace {

CameraMatrix MatrixOf(const TexturedView& view) {
  CameraMatrix P;
  P << view.camera_from_world.R, view.camera_from_world.t;
  return view.camera.K() * P;
}

TextureMatching Match(const std::vector<cv::Mat>& images) {
  return MatchTexture(images, TextureOptions(), ViewGraphOptions(), 2);
}

// Share of the pair's matches within 3 px of the true epipolar lines.
double RightShare(const TexturedScene& scene, const TextureMatching& found, const TexturePair& p) {
  const Eigen::Matrix3d F =
      FundamentalFromCameras(MatrixOf(scene.views[p.view_a]), MatrixOf(scene.views[p.view_b]));
  int right = 0;
  for (const auto& [i, j] : p.matches) {
    right += SampsonSquared(
                 F, found.keypoints[p.view_a].points[i], found.keypoints[p.view_b].points[j]) < 9.0;
  }
  return static_cast<double>(right) / static_cast<double>(p.matches.size());
}

TEST(MatchTexture, PairsKeepToTheTrueEpipolarGeometry) {
  const TexturedScene scene = MakeTexturedScene({.seed = 3, .views = 3});
  const TextureMatching found = Match(RenderTextured(scene));
  ASSERT_EQ(found.pairs.size(), 3u);
  for (const TexturePair& pair : found.pairs) EXPECT_GT(RightShare(scene, found, pair), 0.95);
  EXPECT_GT(found.tracks.size(), 100u);
  for (const FeatureTrack& track : found.tracks) {
    std::set<int> views;
    for (const FeatureTrack::Feature& f : track.features) views.insert(f.view);
    EXPECT_EQ(views.size(), track.features.size());
  }
}

TEST(MatchTexture, PointsOfAPlaneAreOnAHomography) {
  const TexturedScene scene = MakeTexturedScene({.seed = 4, .views = 2, .boxes = 0});
  const TextureMatching found = Match(RenderTextured(scene));
  ASSERT_EQ(found.pairs.size(), 1u);
  EXPECT_GT(found.pairs[0].on_homography, 0.95 * found.pairs[0].matches.size());
}

TEST(MatchTexture, WhatMovesGoesBeforeWhatStandsStill) {
  const TexturedScene scene = OnTurntable(5, 2);
  const TextureMatching found = Match(RenderTextured(scene));
  ASSERT_EQ(found.pairs.size(), 1u);
  EXPECT_GT(found.pairs[0].still, 0);
  for (const auto& [i, j] : found.pairs[0].matches) {
    EXPECT_GT((found.keypoints[0].points[i] - found.keypoints[1].points[j]).norm(), 1.5);
  }
}

TEST(MatchTexture, ImagesWithoutTextureOrOverlapHaveNoPairs) {
  EXPECT_TRUE(Match(RenderTextured(WithoutOverlap(6, 3))).pairs.empty());
  const cv::Mat blank(480, 640, CV_8UC3, cv::Scalar(90, 100, 110));
  const TextureMatching found = Match({blank, blank.clone(), cv::Mat(16, 16, CV_8UC1, 7)});
  EXPECT_TRUE(found.pairs.empty());
  EXPECT_TRUE(found.tracks.empty());
  EXPECT_EQ(found.keypoints.size(), 3u);
}

TEST(MatchTexture, DoesNotDependOnTheNumberOfThreads) {
  const std::vector<cv::Mat> images = RenderTextured(MakeTexturedScene({.seed = 7, .views = 3}));
  const auto one = MatchTexture(images, TextureOptions(), ViewGraphOptions(), 1);
  const auto two = MatchTexture(images, TextureOptions(), ViewGraphOptions(), 2);
  ASSERT_EQ(one.pairs.size(), two.pairs.size());
  for (size_t k = 0; k < one.pairs.size(); ++k)
    EXPECT_EQ(one.pairs[k].matches, two.pairs[k].matches);
}

TEST(MatchTexture, StopsWhenAsked) {
  const std::vector<cv::Mat> images = RenderTextured(MakeTexturedScene({.views = 2}));
  const auto found =
      MatchTexture(images, TextureOptions(), ViewGraphOptions(), 1, [] { return true; });
  EXPECT_TRUE(found.tracks.empty());
}

}  // namespace
}  // namespace horopter
