#include "server/vision/matching/plane_centres.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "tests/support/synthetic_scene.h"

namespace horopter {
namespace {

struct Scene {
  SyntheticScene truth;
  std::vector<PlaneView> views;
  std::vector<PlanePoint> points;
};

Scene MakeScene(unsigned seed, double sigma_px, double wrong_share, bool pure_rotation = false) {
  SyntheticSceneOptions options;
  options.seed = seed;
  options.views = 5;
  options.off_plane_points = 25;
  options.pure_rotation = pure_rotation;
  Scene scene{MakeSyntheticScene(options), {}, {}};
  std::mt19937 rng(seed);
  std::normal_distribution<double> noise(0.0, sigma_px);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  for (int v = 0; v < options.views; ++v)
    scene.views.push_back({scene.truth.PlaneHomographyOf(0, v)});
  for (const Eigen::Vector3d& x : scene.truth.off_plane_points) {
    PlanePoint point;
    for (int v = 0; v < options.views; ++v) {
      if (uniform(rng) < 0.25) continue;
      Eigen::Vector2d p = Project(scene.truth.cameras[v], scene.truth.camera_from_world[v] * x);
      p += Eigen::Vector2d(noise(rng), noise(rng));
      if (uniform(rng) < wrong_share)
        p += Eigen::Vector2d(60 * uniform(rng) - 30, 60 * uniform(rng) - 30);
      point.observations.push_back({v, p});
    }
    if (point.observations.size() >= 2) scene.points.push_back(point);
  }
  return scene;
}

double WorstEpipolar(const SyntheticScene& scene, const PlaneCentres::Pair& pair) {
  double worst = 0.0;
  for (const Eigen::Vector3d& x : scene.off_plane_points) {
    const auto seen = [&](int v) {
      return Project(scene.cameras[v], scene.camera_from_world[v] * x);
    };
    const Eigen::Vector3d l = pair.F * seen(pair.view_a).homogeneous();
    worst = std::max(worst, std::abs(l.dot(seen(pair.view_b).homogeneous())) / l.head<2>().norm());
  }
  return worst;
}

TEST(PlaneCentres, ExactPointsGiveExactGeometryOfAllPairs) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Scene scene = MakeScene(seed, 0.0, 0.0);
    const PlaneCentres r = EstimatePlaneCentres(scene.views, scene.points, {});
    ASSERT_EQ(r.pairs.size(), 10u) << "seed " << seed;
    for (const PlaneCentres::Pair& pair : r.pairs)
      EXPECT_LT(WorstEpipolar(scene.truth, pair), 1e-3) << "seed " << seed;
    EXPECT_LT(r.rms_px, 1e-3);
  }
}

TEST(PlaneCentres, NoiseAndWrongTracksCostLittle) {
  for (unsigned seed = 1; seed <= 15; ++seed) {
    const Scene scene = MakeScene(seed, 0.4, 0.1);
    const PlaneCentres r = EstimatePlaneCentres(scene.views, scene.points, {});
    EXPECT_GE(r.pairs.size(), 6u) << "seed " << seed;
    for (const PlaneCentres::Pair& pair : r.pairs)
      EXPECT_LT(WorstEpipolar(scene.truth, pair), 2.5) << "seed " << seed;
  }
}

TEST(PlaneCentres, AViewThatSeesOtherPointsIsLeftOut) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Scene scene = MakeScene(seed, 0.3, 0.0);
    std::mt19937 rng(seed);
    for (PlanePoint& point : scene.points) {
      for (auto& o : point.observations) {
        if (o.view == 2)
          o.pixel =
              Eigen::Vector2d(static_cast<double>(rng() % 640), static_cast<double>(rng() % 480));
      }
    }
    const PlaneCentres r = EstimatePlaneCentres(scene.views, scene.points, {});
    EXPECT_FALSE(r.epipoles[2]) << "seed " << seed;
    for (const PlaneCentres::Pair& pair : r.pairs) {
      EXPECT_NE(pair.view_a, 2);
      EXPECT_NE(pair.view_b, 2);
    }
  }
}

TEST(PlaneCentres, WithoutParallaxNothingIsClaimed) {
  const Scene scene = MakeScene(1, 0.3, 0.0, /*pure_rotation=*/true);
  EXPECT_TRUE(EstimatePlaneCentres(scene.views, scene.points, {}).pairs.empty());
}

TEST(PlaneCentres, HostileInputGivesNothing) {
  EXPECT_TRUE(EstimatePlaneCentres({}, {}, {}).pairs.empty());
  Scene scene = MakeScene(2, 0.3, 0.0);
  EXPECT_TRUE(EstimatePlaneCentres(scene.views, {}, {}).pairs.empty());
  scene.views[1].view_from_plane.setZero();
  EXPECT_TRUE(EstimatePlaneCentres(scene.views, scene.points, {}).pairs.empty());
}

}  // namespace
}  // namespace horopter
