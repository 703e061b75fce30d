#include "server/vision/matching/plane_patches.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

SyntheticScene TwoViews() {
  SyntheticSceneOptions options;
  options.views = 2;
  options.arc_rad = 0.5;
  return MakeSyntheticScene(options);
}

// b_from_a moved by `shift` pixels and tilted a little.
Eigen::Matrix3d Disturbed(const Eigen::Matrix3d& b_from_a, const Eigen::Vector2d& shift) {
  Eigen::Matrix3d D = Eigen::Matrix3d::Identity();
  D.block<2, 1>(0, 2) = shift;
  D(0, 1) = 0.004;
  D(2, 0) = 4e-6;
  return D * b_from_a;
}

double Share(const PlaneAlignment& aligned) {
  return static_cast<double>(aligned.estimate.inliers.size()) / std::max(1, aligned.matched);
}

class Noise : public testing::TestWithParam<double> {};

TEST_P(Noise, AlignsARoughHomography) {
  const SyntheticScene scene = TwoViews();
  const cv::Mat texture = PlaneTexture(3, 15.0);
  const PatchImage a = PreparePatches(RenderPlane(scene, 0, texture, GetParam()));
  const PatchImage b = PreparePatches(RenderPlane(scene, 1, texture, GetParam()));
  for (const Eigen::Vector2d& shift : std::vector<Eigen::Vector2d>{{0, 0}, {6, -5}, {-7, 2}}) {
    const Eigen::Matrix3d start = Disturbed(scene.PlaneHomographyOf(0, 1), shift);
    const PlaneAlignment aligned = AlignPlane(a, b, start, {});
    EXPECT_GT(aligned.estimate.inliers.size(), 300u);
    EXPECT_GT(Share(aligned), 0.9);
    EXPECT_LT(WorstTransfer(scene, 0, 1, aligned.estimate.b_from_a), 0.15 + 0.03 * GetParam())
        << "shift " << shift.transpose();
  }
}
INSTANTIATE_TEST_SUITE_P(Sweep, Noise, testing::Values(0.0, 2.0, 5.0));

TEST(AlignPlane, GivesOneSetOfPointsOfTheFirstView) {
  const SyntheticScene scene = TwoViews();
  const cv::Mat texture = PlaneTexture(4, 15.0);
  const PatchImage a = PreparePatches(RenderPlane(scene, 0, texture, 1.0));
  const PatchImage b = PreparePatches(RenderPlane(scene, 1, texture, 1.0));
  const PlaneAlignment aligned = AlignPlane(a, b, scene.PlaneHomographyOf(0, 1), {});
  for (const PointPair& p : aligned.estimate.inliers) {
    EXPECT_EQ(p.a.x(), std::round(p.a.x()));  // the grid, whatever the other view is
    EXPECT_EQ(p.a.y(), std::round(p.a.y()));
    EXPECT_LT((Transfer(scene.PlaneHomographyOf(0, 1), p.a) - p.b).norm(), 1.5);
  }
}

// Grain: every patch tells its place across the stripes only; all of them together tell it well.
TEST(AlignPlane, StripesAlignAcrossThemselves) {
  const SyntheticScene scene = TwoViews();
  cv::Mat texture(900, 900, CV_8UC1);
  cv::RNG rng(5);
  std::vector<float> profile(1800);
  for (float& p : profile) p = rng.uniform(0.0f, 255.0f);
  cv::Mat wave(profile), smooth;
  cv::GaussianBlur(wave, smooth, cv::Size(1, 0), 1.0, 7.0);
  cv::normalize(smooth, smooth, 60, 200, cv::NORM_MINMAX);
  for (int y = 0; y < 900; ++y) {
    for (int x = 0; x < 900; ++x) {
      // Slightly bent, as grain is: straight stripes fix no homography at all.
      const double bent = x + 40.0 * std::sin(y / 140.0) + 20.0 * std::sin((x + 2.0 * y) / 230.0);
      texture.at<unsigned char>(y, x) =
          cv::saturate_cast<unsigned char>(smooth.at<float>(static_cast<int>(bent + 400.0)));
    }
  }
  const PatchImage a = PreparePatches(RenderPlane(scene, 0, texture, 1.0));
  const PatchImage b = PreparePatches(RenderPlane(scene, 1, texture, 1.0));
  const Eigen::Matrix3d start = Disturbed(scene.PlaneHomographyOf(0, 1), {4, 3});
  const double before = WorstTransfer(scene, 0, 1, start);
  const PlaneAlignment aligned = AlignPlane(a, b, start, {});
  EXPECT_GT(Share(aligned), 0.65);
  EXPECT_LT(WorstTransfer(scene, 0, 1, aligned.estimate.b_from_a), 0.5 * before);
}

TEST(AlignPlane, WhatMovesOtherwiseFallsOut) {
  const SyntheticScene scene = TwoViews();
  const cv::Mat texture = PlaneTexture(6, 15.0);
  cv::Mat images[2];
  for (int v = 0; v < 2; ++v) {
    images[v] = RenderPlane(scene, v, texture, 1.0);
    // A part with texture of its own, 30 px off the plane's motion.
    const Eigen::Vector2d at =
        v == 0 ? Eigen::Vector2d(300, 220)
               : Transfer(scene.PlaneHomographyOf(0, 1), {300, 220}) + Eigen::Vector2d(30, -10);
    const cv::Rect place(static_cast<int>(at.x()) - 60, static_cast<int>(at.y()) - 60, 120, 120);
    PlaneTexture(7, 40.0)(cv::Rect(100, 100, 120, 120)).copyTo(images[v](place));
  }
  const PlaneAlignment aligned = AlignPlane(PreparePatches(images[0]),
                                            PreparePatches(images[1]),
                                            Disturbed(scene.PlaneHomographyOf(0, 1), {4, 3}),
                                            {});
  EXPECT_LT(WorstTransfer(scene, 0, 1, aligned.estimate.b_from_a), 0.3);
  for (const PointPair& p : aligned.estimate.inliers)
    EXPECT_GT((p.a - Eigen::Vector2d(300, 220)).norm(), 30.0);
}

TEST(AlignPlane, AWrongHomographyFindsFewThatAgree) {
  const SyntheticScene scene = TwoViews();
  const cv::Mat texture = PlaneTexture(8, 15.0);
  const PatchImage a = PreparePatches(RenderPlane(scene, 0, texture, 1.0));
  const PatchImage b = PreparePatches(RenderPlane(scene, 1, texture, 1.0));
  for (const double far : {45.0, 80.0, 150.0}) {
    const PlaneAlignment aligned =
        AlignPlane(a, b, Disturbed(scene.PlaneHomographyOf(0, 1), {far, -far}), {});
    EXPECT_TRUE(aligned.estimate.inliers.size() < 60 || Share(aligned) < 0.65)
        << aligned.estimate.inliers.size() << " of " << aligned.matched;
  }
}

TEST(AlignPlane, BlankNoisyAndDegenerateInputGivesNothing) {
  const cv::Mat blank(240, 320, CV_8UC3, cv::Scalar(90, 120, 150));
  cv::Mat noise[2];
  for (int k = 0; k < 2; ++k) {
    noise[k].create(240, 320, CV_8UC1);
    cv::RNG(20 + k).fill(noise[k], cv::RNG::NORMAL, 128.0, 12.0);
  }
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  EXPECT_EQ(AlignPlane(PreparePatches(blank), PreparePatches(blank), I, {}).matched, 0);
  EXPECT_LT(AlignPlane(PreparePatches(noise[0]), PreparePatches(noise[1]), I, {}).matched, 12);
  const PatchImage image = PreparePatches(noise[0]);
  EXPECT_EQ(AlignPlane(image, image, Eigen::Matrix3d::Zero(), {}).matched, 0);
  EXPECT_EQ(AlignPlane(image, image, Eigen::Matrix3d::Constant(std::nan("")), {}).matched, 0);
  const PatchImage tiny = PreparePatches(cv::Mat(16, 16, CV_8UC1, cv::Scalar(7)));
  EXPECT_EQ(AlignPlane(tiny, image, I, {}).matched, 0);
}

TEST(DetectKeypointsFromAbove, GivesPixelsOfTheImageItself) {
  cv::Mat image(480, 640, CV_8UC1, cv::Scalar(120));
  std::vector<Eigen::Vector2d> blobs;
  for (int y = 260; y < 460; y += 60) {
    for (int x = 60; x < 600; x += 60) {
      blobs.push_back({x, y});
      cv::circle(image, {x, y}, 5, cv::Scalar(170), cv::FILLED, cv::LINE_AA);
    }
  }
  for (const double elevation : {0.44, 0.7, 1.05}) {
    const KeypointSet found =
        DetectKeypointsFromAbove(NormalizeLocalContrast(image), 1.0, elevation, {});
    int hit = 0;
    for (const Eigen::Vector2d& blob : blobs) {
      hit += std::any_of(found.points.begin(), found.points.end(), [&](const Eigen::Vector2d& p) {
        return (p - blob).norm() < 2.0;
      });
    }
    EXPECT_GT(hit, static_cast<int>(blobs.size() / 2)) << "elevation " << elevation;
  }
}

}  // namespace
}  // namespace horopter
