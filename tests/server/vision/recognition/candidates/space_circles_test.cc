#include "server/vision/recognition/candidates/space_circles.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "server/vision/recognition/candidates/corner_search.h"
#include "tests/support/circles.h"
#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

struct Scene {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> poses;
  std::vector<ImageFeatures> features;
  std::vector<FeatureView> Views() const {
    std::vector<FeatureView> views;
    for (std::size_t v = 0; v < cameras.size(); ++v)
      views.push_back({{cameras[v], poses[v]}, &features[v], 1.0});
    return views;
  }
};

Scene See(const std::vector<CircleInSpace>& circles, int views, double noise_px, unsigned seed) {
  Scene scene;
  std::mt19937 rng(seed);
  for (int v = 0; v < views; ++v) {
    const double a = -0.6 + 0.4 * v;
    scene.cameras.push_back(CenteredCamera(640, 480, 900.0 + 30 * v));
    scene.poses.push_back(LookAt({0.5 * std::sin(a), -0.5 * std::cos(a), 0.4}, {0, 0, 0.02}));
    ImageFeatures& f = scene.features.emplace_back();
    for (const CircleInSpace& c : circles)
      f.arcs.push_back(ImageOf(c, scene.cameras[v], scene.poses[v], noise_px, &rng));
  }
  return scene;
}

TEST(FindSpaceCircles, RecoversCentreRadiusAndNormalAsNoiseGrows) {
  for (const double noise : {0.0, 0.3, 0.6}) {
    const unsigned seed = 41;
    SCOPED_TRACE(testing::Message() << "seed " << seed << " noise " << noise);
    std::mt19937 rng(seed);
    std::normal_distribution<double> n;
    std::uniform_real_distribution<double> u(0.0, 1.0);
    int right = 0;
    constexpr int kTrials = 40;
    for (int trial = 0; trial < kTrials; ++trial) {
      // Turned towards the middle camera by up to 60 degrees.
      CircleInSpace truth;
      truth.normal = (Eigen::Vector3d(0.0, -0.78, 0.62) +
                      0.8 * u(rng) * Eigen::Vector3d(n(rng), n(rng), n(rng)).normalized())
                         .normalized();
      truth.center = {0.04 * n(rng), 0.04 * n(rng), 0.03};
      truth.radius_m = 0.01 + 0.02 * u(rng);
      const Scene scene = See({truth}, 4, noise, seed + trial);
      for (const SpaceCircle& c : FindSpaceCircles(scene.Views())) {
        if ((c.center - truth.center).norm() > 0.0015) continue;
        if (std::abs(c.radius_m / truth.radius_m - 1.0) > 0.06) continue;
        if (c.normal.dot(truth.normal) < 0.97 || c.views < 3) continue;
        ++right;
        break;
      }
    }
    EXPECT_GE(right, kTrials - 4);
  }
}

TEST(FindSpaceCircles, OneViewNoParallaxShortArcsAndNoNumbersGiveNone) {
  const CircleInSpace circle{{0, 0, 0.02}, {0, 0, 1}, 0.02};
  Scene scene = See({circle}, 3, 0.0, 1);
  std::vector<FeatureView> views = scene.Views();
  EXPECT_FALSE(FindSpaceCircles(views).empty());
  EXPECT_TRUE(FindSpaceCircles({}).empty());
  EXPECT_TRUE(FindSpaceCircles(std::span(views).first(1)).empty());
  EXPECT_TRUE(FindSpaceCircles(std::vector<FeatureView>(3, views[0])).empty());
  for (ImageFeatures& f : scene.features) f.arcs[0].sweep_rad = 0.5;
  EXPECT_TRUE(FindSpaceCircles(scene.Views()).empty());
  for (ImageFeatures& f : scene.features) {
    f.arcs[0].sweep_rad = 6.0;
    f.arcs[0].semi_major_px = std::numeric_limits<double>::quiet_NaN();
  }
  EXPECT_TRUE(FindSpaceCircles(scene.Views()).empty());
}

TEST(PosesFromCircles, FindsATurnedPartFromItsRim) {
  const auto object = PrepareObject(Disc({})).value();
  const unsigned seed = 5;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  const Rigid3 truth{Eigen::AngleAxisd(0.5, Eigen::Vector3d(0.6, 0.8, 0)).toRotationMatrix(),
                     {0.02, 0.01, 0.03}};
  std::vector<CircleInSpace> rims;
  for (const double z : {0.0, 0.015})
    rims.push_back({truth * Eigen::Vector3d(0, 0, z), truth.R.col(2), 0.03});
  Scene scene = See(rims, 4, 0.3, seed);
  std::vector<ViewEvidence> evidence;
  for (std::size_t v = 0; v < scene.features.size(); ++v) {
    ImageFeatures& f = scene.features[v];
    f.width = 640;
    f.height = 480;
    AddChords(&f);
    evidence.push_back(BuildViewEvidence(f));
  }
  std::vector<KnownView> views;
  for (std::size_t v = 0; v < evidence.size(); ++v)
    views.push_back({{scene.cameras[v], scene.poses[v]}, &evidence[v].maps});
  const std::vector<PooledPose> poses =
      PosesFromCircles(*object, views, FindSpaceCircles(scene.Views()), {});
  ASSERT_FALSE(poses.empty());
  const Rigid3& best = poses[0].plane_from_object;
  // The disc may be turned about its axis, and upside down.
  const Eigen::Vector3d middle(0, 0, 0.0075);
  EXPECT_LT((best * middle - truth * middle).norm(), 0.0015);
  EXPECT_GT(std::abs(best.R.col(2).dot(truth.R.col(2))), 0.98);
  EXPECT_TRUE(PosesFromCircles(*object, views, {}, {}).empty());
}

}  // namespace
}  // namespace horopter
