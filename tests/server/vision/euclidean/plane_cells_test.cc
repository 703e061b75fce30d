#include "server/vision/euclidean/plane_cells.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <random>

#include "server/vision/euclidean/plane_points.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// Two views of the plane z = 0 through lenses with distortion.
struct PlaneScene {
  MetricSceneTruth truth;
  std::vector<std::optional<CalibratedCamera>> views;
  PlanePoints plane;  // the true one

  explicit PlaneScene(unsigned seed) {
    MetricSceneOptions options;
    options.seed = seed;
    options.parts = {PrepareObject(Wedge()).value()};
    options.views = 2;
    options.table = false;
    truth = MakeMetricScene(options);
    truth.cameras[0].k1 = -0.06;
    truth.cameras[1].k1 = -0.02;
    for (int v = 0; v < 2; ++v)
      views.push_back(CalibratedCamera{truth.cameras[v], truth.camera_from_world[v]});
    plane.anchor = truth.camera_from_world[0].Inverse().t;
    plane.plane = {0.0, 0.0, 1.0 / plane.anchor.z()};
  }

  // Without distortion: the matches leave it by up to some pixels.
  Eigen::Matrix3d Homography() const {
    const auto from_plane = [&](int v) {
      Eigen::Matrix3d H;
      H << truth.camera_from_world[v].R.leftCols<2>(), truth.camera_from_world[v].t;
      return Eigen::Matrix3d(truth.cameras[v].K() * H);
    };
    return from_plane(1) * from_plane(0).inverse();
  }

  // Patches whose structure measures one direction well, the other `weak` times as well.
  void AddMatches(int count, double sigma_px, double weak, double outliers, std::mt19937* rng) {
    std::uniform_real_distribution<double> u(0.0, 1.0);
    std::normal_distribution<double> n;
    PlaneHomography pair;
    pair.view_a = 0;
    pair.view_b = 1;
    pair.b_from_a = Homography();
    while (static_cast<int>(pair.inliers_a.size()) < count) {
      const Eigen::Vector2d a(640 * u(*rng), 480 * u(*rng));
      const auto e = PlaneTransferError(*views[0], *views[1], plane, {0, 1, a, {0, 0}});
      if (!e || e->x() < 0 || e->y() < 0 || e->x() > 640 || e->y() > 480) continue;
      const double turn = M_PI * u(*rng);
      const Eigen::Vector2d across(std::cos(turn), std::sin(turn));
      const Eigen::Vector2d along(-across.y(), across.x());
      const Eigen::Matrix2d W = across * across.transpose() + weak * along * along.transpose();
      Eigen::Vector2d b = *e + sigma_px * (n(*rng) * across + n(*rng) / std::sqrt(weak) * along);
      if (u(*rng) < outliers) b += Eigen::Vector2d(3.0, -2.0);
      const Eigen::Vector2d mapped = (pair.b_from_a * a.homogeneous()).hnormalized();
      pair.inliers_a.push_back(a);
      pair.inliers_b.push_back(mapped + W * (b - mapped));
      pair.information.push_back(W);
    }
    truth.matching.planes = {pair};
  }

  // Patches of grain along y, found across it only; the homography is `off_px` off along it.
  void AddGrain(int count, double sigma_px, double noise, double off_px, std::mt19937* rng) {
    AddMatches(count, sigma_px, 1.0, 0.0, rng);
    PlaneHomography& pair = truth.matching.planes[0];
    Eigen::Matrix3d shift = Eigen::Matrix3d::Identity();
    shift(1, 2) = off_px;
    pair.b_from_a = shift * pair.b_from_a;
    for (int i = 0; i < count; ++i) {
      pair.inliers_b[i].y() = (pair.b_from_a * pair.inliers_a[i].homogeneous()).hnormalized().y();
      pair.information[i] = Eigen::Vector2d(1.0, noise).asDiagonal();
    }
  }
};

// Squared errors of the cells in their own deviations; mean 2 when those are honest.
double MeanSquared(const PlaneScene& scene, const ObservedPlane& observed) {
  double sum = 0.0;
  for (const PlaneCell& c : observed.cells) {
    const auto e = PlaneTransferError(
        *scene.views[0], *scene.views[1], scene.plane, {0, 1, c.pixel_a, c.pixel_b});
    if (e) sum += (c.whitening * *e).squaredNorm();
  }
  return sum / static_cast<double>(observed.cells.size());
}

TEST(AveragePlaneMatches, CellsKeepTheDistortionAndStateTheirErrorHonestly) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    for (const double weak : {1.0, 0.3, 0.1}) {
      PlaneScene scene(seed);
      std::mt19937 rng(seed);
      scene.AddMatches(700, 0.15, weak, 0.0, &rng);
      PlaneCellOptions options;
      options.floor_px = 0.0;
      options.noise_share = 0.0;
      const ObservedPlane observed =
          AveragePlaneMatches(scene.truth.matching, scene.views, options);
      ASSERT_GT(observed.cells.size(), 40u);
      const double mean = MeanSquared(scene, observed);
      EXPECT_GT(mean, 1.2) << "seed " << seed << " weak " << weak;
      EXPECT_LT(mean, 3.2) << "seed " << seed << " weak " << weak;
    }
  }
}

// Along grain the search stays where the pair's homography began it, here 3 px off, and noise makes
// the patch look as if it had measured that.
TEST(AveragePlaneMatches, WhatGrainDoesNotMeasureIsNotBelieved) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    PlaneScene scene(seed);
    std::mt19937 rng(seed);
    scene.AddGrain(700, 0.15, 0.25, 3.0, &rng);
    PlaneCellOptions options;
    const double believed =
        MeanSquared(scene, AveragePlaneMatches(scene.truth.matching, scene.views, options));
    EXPECT_LT(believed, 2.5) << "seed " << seed;
    options.noise_share = 0.0;
    const double before =
        MeanSquared(scene, AveragePlaneMatches(scene.truth.matching, scene.views, options));
    EXPECT_GT(before, 20.0) << "seed " << seed;
  }
}

TEST(AveragePlaneMatches, OutliersInACellAreLeftOut) {
  PlaneScene scene(7);
  std::mt19937 rng(7);
  scene.AddMatches(700, 0.15, 0.5, 0.1, &rng);
  const ObservedPlane observed = AveragePlaneMatches(scene.truth.matching, scene.views, {});
  ASSERT_GT(observed.cells.size(), 40u);
  int far = 0;
  for (const PlaneCell& c : observed.cells) {
    const auto e = PlaneTransferError(
        *scene.views[0], *scene.views[1], scene.plane, {0, 1, c.pixel_a, c.pixel_b});
    far += !e || e->norm() > 0.5;
  }
  EXPECT_LE(far, static_cast<int>(observed.cells.size()) / 20);
}

TEST(AveragePlaneMatches, FewMatchesFillLargerCells) {
  PlaneScene scene(8);
  std::mt19937 rng(8);
  scene.AddMatches(40, 0.15, 1.0, 0.0, &rng);
  const ObservedPlane observed = AveragePlaneMatches(scene.truth.matching, scene.views, {});
  EXPECT_GE(observed.cells.size(), 3u);
  EXPECT_LE(observed.cells.size(), 16u);
  EXPECT_LT(MeanSquared(scene, observed), 4.0);
}

TEST(AveragePlaneMatches, NothingFromTooFewOrBrokenMatches) {
  PlaneScene scene(9);
  std::mt19937 rng(9);
  EXPECT_TRUE(AveragePlaneMatches(scene.truth.matching, scene.views, {}).cells.empty());
  scene.AddMatches(5, 0.15, 1.0, 0.0, &rng);
  EXPECT_TRUE(AveragePlaneMatches(scene.truth.matching, scene.views, {}).cells.empty());
  scene.AddMatches(300, 0.15, 1.0, 0.0, &rng);
  scene.truth.matching.planes[0].inliers_b[7].x() = std::numeric_limits<double>::quiet_NaN();
  for (const PlaneCell& c : AveragePlaneMatches(scene.truth.matching, scene.views, {}).cells) {
    EXPECT_TRUE(c.pixel_b.allFinite() && c.whitening.allFinite());
  }
  scene.views[1].reset();
  EXPECT_TRUE(AveragePlaneMatches(scene.truth.matching, scene.views, {}).cells.empty());
}

}  // namespace
}  // namespace horopter
