#include "server/vision/euclidean/texture_points.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <set>

#include "server/vision/euclidean/euclidean.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

struct Space {
  std::vector<AdjustedView> views;
  std::vector<std::optional<CalibratedCamera>> cameras;
  Reconstruction reconstruction;
};

// Points on a table and above it in the images of given cameras, `noise_px` off; every n-th point
// is matched wrongly in its last view.
Reconstruction Seen(const std::vector<PinholeCamera>& cameras,
                    const std::vector<Rigid3>& camera_from_world,
                    int points,
                    double noise_px,
                    int wrong_every,
                    std::mt19937* random) {
  std::normal_distribution<double> noise(0.0, 1.0);
  std::uniform_real_distribution<double> u(-0.25, 0.25);
  Reconstruction out;
  out.trusted = true;
  for (int k = 0; k < points; ++k) {
    const Eigen::Vector3d x(u(*random), u(*random), k % 3 == 0 ? 0.2 * std::abs(u(*random)) : 0.0);
    ReconstructedPoint point;
    for (std::size_t v = 0; v < cameras.size(); ++v) {
      Eigen::Vector2d pixel = Project(cameras[v], camera_from_world[v] * x) +
                              noise_px * Eigen::Vector2d(noise(*random), noise(*random));
      if (wrong_every > 0 && k % wrong_every == 0 && v + 1 == cameras.size())
        pixel += Eigen::Vector2d(30.0, -20.0);
      if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() >= cameras[v].width ||
          pixel.y() >= cameras[v].height)
        continue;
      point.observations.emplace_back(static_cast<int>(v), -1);
      point.pixels.push_back(pixel);
    }
    out.points.push_back(std::move(point));
  }
  return out;
}

Space MakeSpace(int points, double noise_px) {
  Space out;
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> poses;
  for (int v = 0; v < 3; ++v) {
    PinholeCamera camera = CenteredCamera(640, 480, 800.0 + 30 * v);
    camera.k1 = 0.02 * v;
    cameras.push_back(camera);
    poses.push_back(LookAt({0.3 - 0.3 * v, -0.5 + 0.1 * v, 0.5}, {0.0, 0.01 * v, 0.0}));
    out.views.push_back({true, camera, poses.back()});
    out.cameras.emplace_back(CalibratedCamera{camera, poses.back()});
  }
  std::mt19937 random(3);
  out.reconstruction = Seen(cameras, poses, points, noise_px, 0, &random);
  return out;
}

TEST(ChooseTexturePoints, TakesWhatMostViewsSeeAndSpreadsIt) {
  Space space = MakeSpace(2000, 0.0);
  const ObservedTexture few =
      ChooseTexturePoints(space.reconstruction, space.cameras, {.max_points = 60});
  ASSERT_EQ(few.points.size(), 60u);
  std::set<std::pair<int, int>> cells;
  for (const TexturePoint& point : few.points) {
    EXPECT_EQ(point.seen.size(), 3u);
    for (const auto& sight : point.seen) {
      EXPECT_LT((Project(space.views[sight.view].camera,
                         space.views[sight.view].camera_from_scene * point.point_in_scene) -
                 sight.pixel)
                    .norm(),
                1e-6);
    }
    cells.emplace(static_cast<int>(point.seen[0].pixel.x() / 80),
                  static_cast<int>(point.seen[0].pixel.y() / 80));
  }
  EXPECT_GT(cells.size(), 20u);
}

TEST(ChooseTexturePoints, LeavesOutWhatNoTwoKnownViewsShowFromTwoSides) {
  Space space = MakeSpace(50, 0.0);
  space.cameras[1].reset();
  for (const TexturePoint& point :
       ChooseTexturePoints(space.reconstruction, space.cameras, {}).points) {
    for (const auto& sight : point.seen) EXPECT_NE(sight.view, 1);
  }
  space.cameras[2].reset();
  EXPECT_TRUE(ChooseTexturePoints(space.reconstruction, space.cameras, {}).points.empty());
  Space one_place = MakeSpace(50, 0.0);
  for (auto& camera : one_place.cameras) camera = one_place.cameras[0];
  for (ReconstructedPoint& point : one_place.reconstruction.points)
    point.pixels.assign(point.pixels.size(), point.pixels.front());
  EXPECT_TRUE(ChooseTexturePoints(one_place.reconstruction, one_place.cameras, {}).points.empty());
}

// The gradient of the cost with points that follow their cameras.
TEST(LinearizeTexturePoint, GivesTheGradientOfTheCostAtTheBestPoints) {
  const Space space = MakeSpace(20, 1.5);
  // What all three views see is chosen first.
  ObservedTexture texture =
      ChooseTexturePoints(space.reconstruction, space.cameras, {.max_points = 1});
  ASSERT_EQ(texture.points.size(), 1u);
  constexpr double kSlack = 1.3;
  const auto settle = [&](std::span<const AdjustedView> views, ObservedTexture* t) {
    for (int i = 0; i < 10; ++i) FollowCameras(views, kSlack, t);
  };
  settle(space.views, &texture);
  TextureRows rows;
  ASSERT_TRUE(LinearizeTexturePoint(space.views, texture, texture.points[0], kSlack, &rows));
  const Eigen::VectorXd gradient = 2.0 * rows.J.transpose() * rows.residual;
  ASSERT_EQ(rows.views, std::vector<int>({0, 1, 2}));
  for (int v = 0; v < 3; ++v) {
    for (int p = 0; p < kViewParameters; ++p) {
      const double step = p == 7 || p == 8 ? 1e-3 : 1e-6;
      double cost[2];
      for (const int side : {0, 1}) {
        std::vector<AdjustedView> moved = space.views;
        const double d = side == 0 ? -step : step;
        Vector6d pose = Vector6d::Zero();
        if (p < 6) pose(p) = d;
        moved[v].camera_from_scene = Perturbed(moved[v].camera_from_scene, pose);
        if (p == 6) moved[v].camera.focal_px *= std::exp(d);
        if (p == 7) moved[v].camera.cx += d;
        if (p == 8) moved[v].camera.cy += d;
        if (p == 9) moved[v].camera.k1 += d;
        ObservedTexture followed = texture;
        settle(moved, &followed);
        cost[side] = TextureCost(moved, followed, kSlack);
      }
      const double numeric = (cost[1] - cost[0]) / (2.0 * step);
      EXPECT_NEAR(gradient(kViewParameters * v + p), numeric, 1e-3 * (1.0 + std::abs(numeric)))
          << "view " << v << " parameter " << p;
    }
  }
}

TEST(TextureDeviation, IsTheNoiseInSigmas) {
  double deviation[2];
  for (const int k : {0, 1}) {
    const Space space = MakeSpace(1500, 0.4 * (k + 1));
    ObservedTexture texture =
        ChooseTexturePoints(space.reconstruction, space.cameras, {.sigma_px = 0.8});
    FollowCameras(space.views, 1.0, &texture);
    deviation[k] = TextureDeviation(space.views, texture);
    EXPECT_EQ(TextureDeviation(space.views, {}), 0.0);
  }
  // Three sights of two coordinates less the point's three leave half of the squares, two a
  // quarter.
  EXPECT_GT(deviation[1], 0.5);
  EXPECT_LT(deviation[1], std::sqrt(0.5));
  EXPECT_NEAR(deviation[1] / deviation[0], 2.0, 0.2);
}

// A small part in the middle leaves focal length and depth open; what lies around it does not, even
// if some of it is matched wrongly.
TEST(RefineMetricScene, TextureAroundAPartTellsFocalLengths) {
  MetricSceneOptions options;
  options.parts = {PrepareObject(LBracket()).value()};
  options.table = false;
  double without_sum = 0.0, with_sum = 0.0;
  std::vector<double> sigmas;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    options.seed = seed;
    const MetricSceneTruth truth = MakeMetricScene(options);
    std::mt19937 random(seed);
    const Reconstruction texture =
        Seen(truth.cameras, truth.camera_from_world, 800, 0.7, 10, &random);
    RecognitionInput input = truth.Input();
    const auto without = RefineMetricScene(input, truth.recognition, {});
    input.reconstruction = &texture;
    const auto with = RefineMetricScene(input, truth.recognition, {});
    ASSERT_TRUE(without.ok() && with.ok());
    EXPECT_EQ(without->counts.at("texture_points"), 0.0);
    EXPECT_EQ(with->counts.at("texture_points"), 300.0);
    for (std::size_t v = 0; v < truth.cameras.size(); ++v) {
      const double f = truth.cameras[v].focal_px;
      without_sum += std::abs(std::log(without->cameras[v]->camera.focal_px / f));
      const double off = std::log(with->cameras[v]->camera.focal_px / f);
      with_sum += std::abs(off);
      sigmas.push_back(std::abs(off) / with->cameras[v]->focal_log_sigma);
      EXPECT_LT(with->cameras[v]->focal_log_sigma, without->cameras[v]->focal_log_sigma);
    }
  }
  EXPECT_LT(with_sum, 0.5 * without_sum);
  EXPECT_GE(std::count_if(sigmas.begin(), sigmas.end(), [](double s) { return s < 2.0; }),
            static_cast<long>(0.85 * static_cast<double>(sigmas.size())));
}

// Of a reconstruction that is not to be trusted, nothing is taken.
TEST(RefineMetricScene, UntrustedTextureTakesNoPart) {
  MetricSceneOptions options;
  options.parts = {PrepareObject(LBracket()).value()};
  const MetricSceneTruth truth = MakeMetricScene(options);
  std::mt19937 random(1);
  Reconstruction texture = Seen(truth.cameras, truth.camera_from_world, 100, 0.5, 0, &random);
  texture.trusted = false;
  RecognitionInput input = truth.Input();
  input.reconstruction = &texture;
  const auto metric = RefineMetricScene(input, truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  EXPECT_EQ(metric->counts.at("texture_points"), 0.0);
}

}  // namespace
}  // namespace horopter
