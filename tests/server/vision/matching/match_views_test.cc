#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

#include "server/vision/matching/homography.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/plane_homography.h"
#include "tests/support/synthetic_scene.h"
#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

std::vector<ImageFeatures> EmptyFeatures(const std::vector<cv::Mat>& images) {
  std::vector<ImageFeatures> features(images.size());
  for (size_t i = 0; i < images.size(); ++i) {
    features[i].width = images[i].cols;
    features[i].height = images[i].rows;
  }
  return features;
}

MatchingResult Match(const std::vector<cv::Mat>& images, const MatchingOptions& options = {}) {
  const auto r = MatchViews(images, EmptyFeatures(images), options);
  EXPECT_TRUE(r.ok()) << r.status();
  return r.ok() ? *r : MatchingResult();
}

SyntheticScene Scene(int views) {
  SyntheticSceneOptions options;
  options.views = views;
  options.arc_rad = 0.3 * (views - 1);
  return MakeSyntheticScene(options);
}

TEST(MatchViews, FindsAndChainsAFaintPlane) {
  const SyntheticScene scene = Scene(3);
  const cv::Mat texture = PlaneTexture(1, 6.0);
  std::vector<cv::Mat> images;
  for (int v = 0; v < 3; ++v) images.push_back(RenderPlane(scene, v, texture, 1.0));
  const MatchingResult r = Match(images);
  EXPECT_EQ(r.component, (std::vector<int>{0, 0, 0}));
  ASSERT_GE(r.planes.size(), 2u);
  for (const PlaneHomography& p : r.planes) {
    EXPECT_GE(p.inliers_a.size(), 14u);
    EXPECT_EQ(p.inliers_a.size(), p.inliers_b.size());
    EXPECT_LT(WorstTransfer(scene, p.view_a, p.view_b, p.b_from_a), 1.0);
  }
  for (int v = 1; v < 3; ++v) EXPECT_LT(WorstTransfer(scene, 0, v, r.view_from_plane[v]), 1.0);
  // A bare plane proves no parallax.
  for (const PairGeometry& pair : r.pairs) {
    EXPECT_FALSE(pair.F);
    EXPECT_FALSE(pair.refusal.empty());
  }
}

TEST(MatchViews, ResultDoesNotDependOnThreadsOrRepetition) {
  const SyntheticScene scene = Scene(3);
  const cv::Mat texture = PlaneTexture(2, 20.0);
  std::vector<cv::Mat> images;
  for (int v = 0; v < 3; ++v) images.push_back(RenderPlane(scene, v, texture, 1.0));
  MatchingOptions one, three;
  one.threads = 1;
  three.threads = 3;
  const MatchingResult a = Match(images, one), b = Match(images, three);
  ASSERT_EQ(a.planes.size(), b.planes.size());
  for (size_t k = 0; k < a.planes.size(); ++k)
    EXPECT_EQ(a.planes[k].b_from_a, b.planes[k].b_from_a);
  for (size_t v = 0; v < 3; ++v) EXPECT_EQ(a.view_from_plane[v], b.view_from_plane[v]);
}

TEST(MatchViews, LeavesItsImagesAloneAndRepeatsItself) {
  const SyntheticScene scene = Scene(2);
  const cv::Mat texture = PlaneTexture(8, 20.0);
  std::vector<cv::Mat> images, before;
  std::vector<ImageFeatures> features;
  for (int v = 0; v < 2; ++v) {
    cv::Mat colour;
    cv::cvtColor(RenderPlane(scene, v, texture, 1.0), colour, cv::COLOR_GRAY2BGR);
    images.push_back(colour);
    before.push_back(colour.clone());
    ImageFeatures f;
    f.width = colour.cols;
    f.height = colour.rows;
    for (int k = 0; k < 40; ++k) {
      Junction junction;
      junction.point = {40.0 + 14.0 * k, 60.0 + 9.0 * ((7 * k) % 40)};
      f.junctions.push_back(junction);
    }
    features.push_back(f);
  }
  const auto a = MatchViews(images, features, {});
  for (int v = 0; v < 2; ++v) EXPECT_EQ(cv::norm(images[v], before[v], cv::NORM_INF), 0.0);
  const auto b = MatchViews(images, features, {});
  ASSERT_TRUE(a.ok() && b.ok());
  ASSERT_EQ(a->pairs[0].matches.size(), b->pairs[0].matches.size());
  for (size_t k = 0; k < a->pairs[0].matches.size(); ++k) {
    EXPECT_EQ(a->pairs[0].matches[k].junction_a, b->pairs[0].matches[k].junction_a);
    EXPECT_EQ(a->pairs[0].matches[k].junction_b, b->pairs[0].matches[k].junction_b);
  }
}

TEST(MatchViews, IdenticalImagesAreCountedAndShowNoParallax) {
  const SyntheticScene scene = Scene(1);
  const std::vector<cv::Mat> images(3, RenderPlane(scene, 0, PlaneTexture(3, 20.0), 1.0));
  const MatchingResult r = Match(images);
  EXPECT_EQ(r.counts.at("identical_views"), 3);
  ASSERT_EQ(r.planes.size(), 3u);
  for (const PlaneHomography& p : r.planes) EXPECT_LT(WorstTransfer(scene, 0, 0, p.b_from_a), 0.02);
  for (const PairGeometry& pair : r.pairs)
    EXPECT_THAT(pair.refusal, testing::HasSubstr("no parallax"));
}

TEST(MatchViews, ForeignAndMirroredImagesStayUnlinked) {
  const SyntheticScene scene = Scene(2);
  const cv::Mat texture = PlaneTexture(4, 20.0);
  cv::Mat mirrored;
  cv::flip(RenderPlane(scene, 1, texture, 1.0), mirrored, 1);
  const std::vector<cv::Mat> images = {RenderPlane(scene, 0, texture, 1.0),
                                       RenderPlane(scene, 1, texture, 1.0),
                                       RenderPlane(scene, 0, PlaneTexture(5, 20.0), 1.0),
                                       mirrored};
  const MatchingResult r = Match(images);
  EXPECT_EQ(r.component, (std::vector<int>{0, 0, -1, -1}));
}

TEST(MatchViews, BlankTinyAndNoisyImagesGiveAnEmptyResult) {
  cv::Mat noise(480, 640, CV_8UC3), blank(480, 640, CV_8UC3, cv::Scalar(90, 90, 90));
  cv::RNG rng(6);
  rng.fill(noise, cv::RNG::UNIFORM, 0, 255);
  const MatchingResult r = Match({blank,
                                  noise,
                                  blank,
                                  cv::Mat(1, 1, CV_8UC1, cv::Scalar(7)),
                                  cv::Mat::zeros(16, 16, CV_8UC3)});
  EXPECT_TRUE(r.planes.empty());
  EXPECT_EQ(r.component, (std::vector<int>(5, -1)));
  EXPECT_EQ(r.counts.at("identical_views"), 1);
  EXPECT_TRUE(Match({}).planes.empty());
  EXPECT_EQ(Match({blank}).component, std::vector<int>{-1});
}

TEST(MatchViews, BadInputNamesTheOffender) {
  const cv::Mat image(48, 64, CV_8UC3, cv::Scalar(1, 2, 3));
  std::vector<cv::Mat> images = {image, image};
  EXPECT_EQ(MatchViews(images, {}, {}).status().code(), absl::StatusCode::kInvalidArgument);
  std::vector<ImageFeatures> features = EmptyFeatures(images);
  features[1].width = 63;
  const auto size = MatchViews(images, features, {});
  EXPECT_EQ(size.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(size.status().message()), testing::HasSubstr("image 1"));
  images[0] = cv::Mat(48, 64, CV_16UC1, cv::Scalar(0));
  EXPECT_EQ(MatchViews(images, EmptyFeatures(images), {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  images[0] = image;
  EXPECT_EQ(MatchViews(images, EmptyFeatures(images), {}, [] { return true; }).status().code(),
            absl::StatusCode::kCancelled);
}

TEST(MatchKeypoints, IsSymmetricInItsMutualPairs) {
  const SyntheticScene scene = Scene(2);
  const cv::Mat texture = PlaneTexture(7, 20.0);
  const MatchingOptions options;
  const KeypointSet a = DetectPlaneKeypoints(RenderPlane(scene, 0, texture, 1.0), 1.0, options);
  const KeypointSet b = DetectPlaneKeypoints(RenderPlane(scene, 1, texture, 1.0), 1.0, options);
  std::set<std::pair<double, double>> forward, backward;
  for (const PointPair& p : MatchKeypoints(a, b, 1.0)) forward.insert({p.a.x(), p.b.x()});
  for (const PointPair& p : MatchKeypoints(b, a, 1.0)) backward.insert({p.b.x(), p.a.x()});
  size_t common = 0;
  for (const auto& p : forward) common += backward.count(p);
  EXPECT_GT(forward.size(), 100u);
  EXPECT_GT(common, forward.size() * 95 / 100);  // the ratio test alone is one-sided
}

}  // namespace
}  // namespace horopter
