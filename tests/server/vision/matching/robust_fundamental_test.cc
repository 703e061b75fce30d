#include "server/vision/matching/robust_fundamental.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>

#include "tests/support/synthetic_scene.h"

namespace horopter {
namespace {

struct Pair {
  SyntheticScene scene;
  std::vector<WeightedMatch> matches;  // right ones first
};

// Views 0 and 1 of points off the plane (or of the plane), with noise and `wrong` arbitrary
// matches.
Pair MakePair(unsigned seed, double sigma_px, int wrong, bool planar, bool pure_rotation = false) {
  SyntheticSceneOptions options;
  options.seed = seed;
  options.views = 2;
  options.arc_rad = 0.5;
  options.off_plane_points = 40;
  options.plane_points = 40;
  options.pure_rotation = pure_rotation;
  Pair pair{MakeSyntheticScene(options), {}};
  std::mt19937 rng(seed);
  std::normal_distribution<double> noise(0.0, sigma_px);
  const auto seen = [&](int v, const Eigen::Vector3d& x) {
    const Eigen::Vector2d p = Project(pair.scene.cameras[v], pair.scene.camera_from_world[v] * x);
    return Eigen::Vector2d(p.x() + noise(rng), p.y() + noise(rng));
  };
  for (const Eigen::Vector3d& x : planar ? pair.scene.plane_points : pair.scene.off_plane_points)
    pair.matches.push_back({seen(0, x), seen(1, x), 2.0});
  std::uniform_real_distribution<double> anywhere(0.0, 1.0);
  for (int k = 0; k < wrong; ++k) {
    const Eigen::Vector2d a(640 * anywhere(rng), 480 * anywhere(rng));
    const Eigen::Vector2d b(640 * anywhere(rng), 480 * anywhere(rng));
    pair.matches.push_back({a, b, 1.0});
  }
  return pair;
}

double WorstEpipolar(const SyntheticScene& scene, const Eigen::Matrix3d& F) {
  double worst = 0.0;
  for (const Eigen::Vector3d& x : scene.off_plane_points) {
    const Eigen::Vector2d a = Project(scene.cameras[0], scene.camera_from_world[0] * x);
    const Eigen::Vector2d b = Project(scene.cameras[1], scene.camera_from_world[1] * x);
    const Eigen::Vector3d l = F * a.homogeneous();
    worst = std::max(worst, std::abs(l.dot(b.homogeneous())) / l.head<2>().norm());
  }
  return worst;
}

TEST(RobustFundamental, ErrorGrowsWithTheNoiseAndNotWithWrongMatches) {
  for (const double sigma : {0.0, 0.2, 0.5}) {
    for (unsigned seed = 1; seed <= 10; ++seed) {
      const Pair pair = MakePair(seed, sigma, 20, false);
      const RobustFundamental r = EstimateFundamental(pair.matches, {});
      ASSERT_TRUE(r.F) << "seed " << seed << ": " << r.refusal;
      EXPECT_LT(WorstEpipolar(pair.scene, *r.F), 1.0 + 4.0 * sigma) << "seed " << seed;
      EXPECT_NEAR(r.F->norm(), 1.0, 1e-12);
      EXPECT_NEAR(r.F->determinant(), 0.0, 1e-12);
      EXPECT_GE(r.inliers.size(), 35u) << "seed " << seed;
    }
  }
}

TEST(RobustFundamental, APlaneAndARotationAreRefusedAsNoParallax) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    const RobustFundamental plane = EstimateFundamental(MakePair(seed, 0.3, 0, true).matches, {});
    EXPECT_FALSE(plane.F) << "seed " << seed;
    EXPECT_THAT(plane.refusal, testing::HasSubstr("no parallax")) << "seed " << seed;
    const RobustFundamental rotation =
        EstimateFundamental(MakePair(seed, 0.3, 0, false, true).matches, {});
    EXPECT_FALSE(rotation.F) << "seed " << seed;
    EXPECT_THAT(rotation.refusal, testing::HasSubstr("no parallax")) << "seed " << seed;
  }
}

TEST(RobustFundamental, ArbitraryMatchesAreRefused) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Pair pair = MakePair(seed, 0.3, 60, false);
    pair.matches.erase(pair.matches.begin(), pair.matches.begin() + 40);
    EXPECT_FALSE(EstimateFundamental(pair.matches, {}).F) << "seed " << seed;
  }
}

TEST(RobustFundamental, HostileInputIsARefusal) {
  EXPECT_FALSE(EstimateFundamental({}, {}).F);
  std::vector<WeightedMatch> same(20, WeightedMatch{{10, 10}, {20, 20}, 1.0});
  EXPECT_FALSE(EstimateFundamental(same, {}).F);
  Pair pair = MakePair(1, 0.3, 0, false);
  pair.matches[3].a.x() = std::numeric_limits<double>::quiet_NaN();
  const RobustFundamental r = EstimateFundamental(pair.matches, {});
  EXPECT_FALSE(r.F);
  EXPECT_FALSE(r.refusal.empty());
}

TEST(RobustFundamental, StatedDeviationsAreHonest) {
  // Offset of a true point's epipolar line over its stated deviation.
  double sum = 0.0;
  int count = 0;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    const Pair pair = MakePair(seed, 0.4, 0, false);
    const RefinedFundamental r =
        RefineFundamental(pair.scene.FundamentalOf(0, 1), pair.matches, 1.0);
    for (size_t k = 0; k < pair.matches.size(); ++k) {
      const Eigen::Vector3d& x = pair.scene.off_plane_points[k];
      const Eigen::Vector2d a = Project(pair.scene.cameras[0], pair.scene.camera_from_world[0] * x);
      const Eigen::Vector2d b = Project(pair.scene.cameras[1], pair.scene.camera_from_world[1] * x);
      const Eigen::Vector3d l = r.F * a.homogeneous();
      const double e = l.dot(b.homogeneous()) / l.head<2>().norm() / r.line_sigma_px[k];
      sum += e * e;
      ++count;
    }
  }
  const double ratio = std::sqrt(sum / count);
  EXPECT_GT(ratio, 0.6);
  EXPECT_LT(ratio, 1.5);
}

TEST(RobustFundamental, TrueGeometryHasPlausibleCamerasAndArbitraryOnesHaveNot) {
  int strained = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const Pair pair = MakePair(seed, 0.2, 0, false);
    const CalibratedFundamental r =
        RefineCalibrated(pair.scene.FundamentalOf(0, 1), pair.matches, 1.0, {});
    EXPECT_LT(r.strain, 0.06) << "seed " << seed;
    EXPECT_LT(WorstEpipolar(pair.scene, r.refined.F), 1.5) << "seed " << seed;
    for (int v = 0; v < 2; ++v) {
      const double found = v == 0 ? r.focal_a_px : r.focal_b_px;
      EXPECT_LT(std::abs(std::log(found / pair.scene.cameras[v].focal_px)), 0.5) << "seed " << seed;
    }
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    Eigen::Matrix3d F;
    for (int k = 0; k < 9; ++k) F(k) = normal(rng) / std::pow(640.0, (k % 3 < 2) + (k / 3 < 2));
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
    F -= svd.singularValues()(2) * svd.matrixU().col(2) * svd.matrixV().col(2).transpose();
    strained += CalibrationStrain(F, {}) > 0.12;
  }
  EXPECT_GE(strained, 12);
}

}  // namespace
}  // namespace horopter
