// One camera for all views where the images say so, and only there.
#include "server/vision/euclidean/shared_camera.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "server/vision/euclidean/euclidean.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

constexpr int kScenes = 10;

MetricSceneOptions Options(unsigned seed) {
  static const auto bracket = PrepareObject(LBracket()).value();
  static const auto wedge = PrepareObject(Wedge()).value();
  MetricSceneOptions options;
  options.seed = seed;
  options.parts = {bracket, wedge};
  return options;
}

double WorstFocalError(const MetricScene& metric, const MetricSceneTruth& truth) {
  double worst = 0.0;
  for (std::size_t v = 0; v < truth.cameras.size(); ++v) {
    worst = std::max(
        worst, std::abs(std::log(metric.cameras[v]->camera.focal_px / truth.cameras[v].focal_px)));
  }
  return worst;
}

TEST(JudgeCameras, SeesOneCameraAndKnowsItBetterForIt) {
  int seen = 0;
  std::vector<double> alone, shared;
  for (unsigned seed = 1; seed <= kScenes; ++seed) {
    MetricSceneOptions options = Options(seed);
    options.one_camera = true;
    options.end_sigma_px = 0.1;  // with 0.3 half of the scenes leave it open
    const MetricSceneTruth truth = MakeMetricScene(options);
    EuclideanOptions each;
    each.cameras.least_log_odds = 1e9;
    const auto together = RefineMetricScene(truth.Input(), truth.recognition, {});
    const auto apart = RefineMetricScene(truth.Input(), truth.recognition, each);
    ASSERT_TRUE(together.ok() && apart.ok()) << "seed " << seed;
    EXPECT_EQ(apart->counts.at("views_of_one_camera"), 0);
    if (together->counts.at("views_of_one_camera") == 0) continue;
    ++seen;
    shared.push_back(WorstFocalError(*together, truth));
    alone.push_back(WorstFocalError(*apart, truth));
    for (std::size_t v = 1; v < truth.cameras.size(); ++v) {
      EXPECT_NEAR(
          together->cameras[v]->camera.focal_px / together->cameras[0]->camera.focal_px, 1.0, 2e-3)
          << "seed " << seed;
    }
  }
  EXPECT_GE(seen, kScenes - 2);
  std::sort(shared.begin(), shared.end());
  std::sort(alone.begin(), alone.end());
  EXPECT_LT(shared[shared.size() / 2], 0.8 * alone[alone.size() / 2]);
}

// But where they lead nowhere near the truth, and one camera explains the edges as well.
TEST(JudgeCameras, LeavesUnlikeFocalLengthsApart) {
  EuclideanOptions each;
  each.cameras.unbelievable_log_focal = 1e9;
  int left = 0;
  for (unsigned seed = 1; seed <= kScenes; ++seed) {
    const MetricSceneTruth truth = MakeMetricScene(Options(seed));
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok()) << "seed " << seed;
    if (metric->counts.at("views_of_one_camera") == 0) {
      ++left;
      continue;
    }
    const auto apart = RefineMetricScene(truth.Input(), truth.recognition, each);
    ASSERT_TRUE(apart.ok()) << "seed " << seed;
    EXPECT_LT(WorstFocalError(*metric, truth), WorstFocalError(*apart, truth)) << "seed " << seed;
  }
  EXPECT_GE(left, kScenes - 1);
}

TEST(AreUnbelievable, AsksThreeViewsWhoseFocalLengthsNoLensHas) {
  SceneBundle bundle;
  for (const double focal_px : {627.0, 615.0, 1450.0, 700.0})
    bundle.views.push_back({true, CenteredCamera(1280, 800, focal_px), Rigid3{}});
  const SharedCameraOptions options;
  EXPECT_TRUE(AreUnbelievable(bundle, {0, 1, 2}, options));
  EXPECT_FALSE(AreUnbelievable(bundle, {0, 1, 3}, options));
  EXPECT_FALSE(AreUnbelievable(bundle, {0, 2}, options));
}

// Focal lengths of 1.1 to 1.9 widths in one set look as if they could not be believed: what one
// camera for all leaves in the edges says that they are.
TEST(JudgeCameras, LensesThatAreVeryUnlikeStayApartAndAsExactAsTheyWere) {
  int unlike = 0;
  for (unsigned seed = 1; seed <= kScenes; ++seed) {
    const MetricSceneTruth truth = MakeMetricScene(Options(seed));
    double least = 1e9, most = 0.0;
    for (const PinholeCamera& c : truth.cameras) {
      least = std::min(least, c.focal_px);
      most = std::max(most, c.focal_px);
    }
    if (std::log(most / least) < SharedCameraOptions{}.unbelievable_log_focal) continue;
    ++unlike;
    EuclideanOptions each;
    each.cameras.unbelievable_log_focal = 1e9;
    const auto asked = RefineMetricScene(truth.Input(), truth.recognition, {});
    const auto apart = RefineMetricScene(truth.Input(), truth.recognition, each);
    ASSERT_TRUE(asked.ok() && apart.ok()) << "seed " << seed;
    EXPECT_LE(WorstFocalError(*asked, truth), WorstFocalError(*apart, truth)) << "seed " << seed;
  }
  EXPECT_GE(unlike, 3);
}

TEST(JudgeCameras, AsksNothingOfCamerasThatAreGiven) {
  MetricSceneOptions options = Options(3);
  options.one_camera = true;
  const MetricSceneTruth truth = MakeMetricScene(options);
  RecognitionInput input = truth.Input();
  std::vector<CameraHint> hints(truth.cameras.size());
  for (std::size_t v = 0; v < hints.size(); ++v) hints[v].focal_px = truth.cameras[v].focal_px;
  input.hints = hints;
  const auto metric = RefineMetricScene(input, truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  EXPECT_EQ(metric->counts.at("views_of_one_camera"), 0);
}

TEST(Similarity, OfTheSameIntrinsicsCostsNothingAndItsDerivativesAreThoseOfTheCost) {
  std::vector<AdjustedView> views(3);
  for (int v = 0; v < 3; ++v) {
    views[v].known = true;
    views[v].camera = CenteredCamera(640, 480, 900.0);
  }
  const std::vector<CameraSimilarity> alike{{{0, 2}, 0.01, 0.5, 0.002}};
  EXPECT_EQ(SimilarityCost(views, alike), 0.0);
  views[0].camera.focal_px *= 1.02;
  views[1].camera.focal_px *= 3.0;  // in no group
  views[2].camera.cx += 2.0;
  views[2].camera.k1 = 0.01;
  const std::vector<int> at{0, 4, 8};
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(12, 12);
  Eigen::VectorXd b = Eigen::VectorXd::Zero(12);
  AddSimilarity(views, alike, at, &A, &b);
  const double cost = SimilarityCost(views, alike);
  for (int i = 0; i < 12; ++i) {
    constexpr double kStep = 1e-4;
    std::vector<AdjustedView> moved = views;
    PinholeCamera& c = moved[i / 4].camera;
    if (i % 4 == 0) c.focal_px *= std::exp(kStep);
    if (i % 4 == 1) c.cx += kStep;
    if (i % 4 == 2) c.cy += kStep;
    if (i % 4 == 3) c.k1 += kStep;
    // The cost is quadratic in log f, cx, cy, k1: b is half its slope, A half its curvature.
    EXPECT_NEAR(SimilarityCost(moved, alike) - cost,
                2.0 * kStep * b(i) + kStep * kStep * A(i, i),
                1e-9 * (1.0 + cost))
        << i;
  }
}

}  // namespace
}  // namespace horopter
