// Lenses with more than one coefficient, seen in synthetic scenes.
#include "server/vision/euclidean/lens_terms.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "server/vision/euclidean/euclidean.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// Of a scene, seen through lenses with these terms.
void Distort(const LensTerms& terms, MetricSceneTruth* scene) {
  const auto moved = [&](int view, const Eigen::Vector2d& u) {
    return Eigen::Vector2d(u + ShiftByTerms(scene->cameras[view], terms, u));
  };
  for (std::size_t v = 0; v < scene->features.size(); ++v) {
    for (Segment& s : scene->features[v].segments) {
      s.start = moved(static_cast<int>(v), s.start);
      s.end = moved(static_cast<int>(v), s.end);
    }
  }
  for (PlaneHomography& pair : scene->matching.planes) {
    for (Eigen::Vector2d& u : pair.inliers_a) u = moved(pair.view_a, u);
    for (Eigen::Vector2d& u : pair.inliers_b) u = moved(pair.view_b, u);
  }
}

// Matches of the table all over the views.
void AddTexture(unsigned seed, MetricSceneTruth* scene) {
  constexpr double kSigmaPx = 0.3;
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> x(0.0, 639.0), y(0.0, 479.0);
  std::normal_distribution<double> noise(0.0, kSigmaPx);
  for (PlaneHomography& pair : scene->matching.planes) {
    for (int i = 0; i < 600; ++i) {
      const Eigen::Vector2d a(x(rng), y(rng));
      const Eigen::Vector2d b = (pair.b_from_a * a.homogeneous()).hnormalized();
      if (b.x() < 0 || b.y() < 0 || b.x() > 639 || b.y() > 479) continue;
      pair.inliers_a.push_back(a + Eigen::Vector2d(noise(rng), noise(rng)));
      pair.inliers_b.push_back(b + Eigen::Vector2d(noise(rng), noise(rng)));
    }
  }
}

MetricSceneTruth MakeScene(unsigned seed) {
  MetricSceneOptions options;
  options.seed = seed;
  options.parts = {PrepareObject(LBracket()).value(), PrepareObject(Wedge()).value()};
  options.min_focal_widths = 0.9;
  options.max_focal_widths = 1.2;
  options.one_camera = true;
  options.distance_m = 0.42;
  MetricSceneTruth scene = MakeMetricScene(options);
  AddTexture(seed, &scene);
  return scene;
}

// Millimetres between the parts' centres, off.
double RelativeError(const MetricSceneTruth& scene, const MetricScene& metric) {
  const auto between = [&](const Rigid3& a, const Rigid3& b) {
    return Eigen::Vector3d(a.Inverse() * (b * scene.objects[1]->center));
  };
  return 1000.0 *
         (between(metric.objects[0].scene_from_object, metric.objects[1].scene_from_object) -
          between(scene.world_from_object[0], scene.world_from_object[1]))
             .norm();
}

TEST(ShiftByTerms, IsThatOfBrownsModelAndUndone) {
  const PinholeCamera camera = CenteredCamera(640, 480, 600.0);
  const LensTerms terms{0.2, 0.003, -0.002};
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> x(0.0, 639.0), y(0.0, 479.0);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector2d u(x(rng), y(rng));
    const Eigen::Vector2d n = NormalizedPoint(camera, u);
    const double r2 = n.squaredNorm();
    const Eigen::Vector2d tangential(
        2 * terms.p1 * n.x() * n.y() + terms.p2 * (r2 + 2 * n.x() * n.x()),
        terms.p1 * (r2 + 2 * n.y() * n.y()) + 2 * terms.p2 * n.x() * n.y());
    const Eigen::Vector2d expected = camera.focal_px * (terms.k2 * r2 * r2 * n + tangential);
    const Eigen::Vector2d shift = ShiftByTerms(camera, terms, u);
    EXPECT_LT((shift - expected).norm(), 1e-9);
    EXPECT_LT((WithoutTerms(camera, terms, u + shift) - u).norm(), 1e-3);
  }
  EXPECT_TRUE(ShiftByTerms(camera, {}, {3, 4}).isZero());
}

TEST(LensTerms, AreProvenAndImproveThePoses) {
  const LensTerms terms{0.2, 0.003, -0.003};
  double with = 0.0, without = 0.0;
  int proven = 0;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    MetricSceneTruth scene = MakeScene(seed);
    Distort(terms, &scene);
    EuclideanOptions k1_alone;
    k1_alone.lens.estimate = false;
    const auto free = RefineMetricScene(scene.Input(), scene.recognition, {});
    const auto held = RefineMetricScene(scene.Input(), scene.recognition, k1_alone);
    ASSERT_TRUE(free.ok() && held.ok()) << "seed " << seed;
    if (free->counts.at("lens_terms") > 0.0) ++proven;
    EXPECT_EQ(held->counts.at("lens_terms"), 0.0);
    EXPECT_LE(free->rms_px, held->rms_px) << "seed " << seed;
    with += RelativeError(scene, *free);
    without += RelativeError(scene, *held);
  }
  EXPECT_GE(proven, 4);
  EXPECT_LT(with, 0.85 * without);
}

TEST(LensTerms, AreNotSeenWhereThereAreNone) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const MetricSceneTruth scene = MakeScene(seed);
    const auto metric = RefineMetricScene(scene.Input(), scene.recognition, {});
    ASSERT_TRUE(metric.ok()) << metric.status();
    EXPECT_EQ(metric->counts.at("lens_terms"), 0.0) << "seed " << seed;
    for (const auto& camera : metric->cameras) EXPECT_TRUE(!camera || camera->lens.none());
  }
}

TEST(LensTerms, OfAKnownLensAreNotAskedFor) {
  MetricSceneTruth scene = MakeScene(1);
  Distort({0.35, 0.004, -0.004}, &scene);
  RecognitionInput input = scene.Input();
  std::vector<CameraHint> hints(scene.cameras.size());
  for (CameraHint& hint : hints) hint.k1 = 0.0;
  input.hints = hints;
  const auto metric = RefineMetricScene(input, scene.recognition, {});
  ASSERT_TRUE(metric.ok()) << metric.status();
  EXPECT_EQ(metric->counts.at("lens_terms"), 0.0);
}

TEST(FitLensTerms, NothingSeenIsNoFit) {
  SceneBundle bundle;
  EXPECT_FALSE(FitLensTerms(bundle, {}, {}).has_value());
}

}  // namespace
}  // namespace horopter
