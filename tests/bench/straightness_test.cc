#include "tests/bench/straightness.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "tests/server/vision/features/synthetic_chains.h"

namespace horopter {
namespace {

PinholeCamera Camera(double k1) {
  PinholeCamera camera = CenteredCamera(640, 480, 500.0);
  camera.k1 = k1;
  return camera;
}

// The chain as the lens shows it: its points taken as undistorted pixels of the camera.
EdgeChain Distorted(const SyntheticChain& chain,
                    const PinholeCamera& camera,
                    double noise,
                    std::mt19937* rng) {
  std::normal_distribution<double> normal(0.0, noise);
  EdgeChain out;
  for (size_t i = 0; i < chain.points.size(); ++i) {
    const Eigen::Vector2d n =
        (chain.points[i] - Eigen::Vector2d(camera.cx, camera.cy)) / camera.focal_px;
    out.points.push_back(
        (Project(camera, Eigen::Vector3d(n.x(), n.y(), 1.0)) + normal(*rng) * chain.normals[i])
            .cast<float>());
  }
  return out;
}

Eigen::Vector2d RandomPoint(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  return {40 + 560 * u(*rng), 40 + 400 * u(*rng)};
}

SyntheticChain RandomLine(double length, std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 2 * M_PI);
  for (;;) {
    const Eigen::Vector2d a = RandomPoint(rng);
    const double heading = u(*rng);
    const Eigen::Vector2d b = a + length * Eigen::Vector2d(std::cos(heading), std::sin(heading));
    if (b.x() > 10 && b.x() < 630 && b.y() > 10 && b.y() < 470) {
      return ChainWalk(a, heading).Line(length).chain();
    }
  }
}

SyntheticChain RandomCurve(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double radius = 60 + 400 * u(*rng);
  return ChainWalk(RandomPoint(rng), 2 * M_PI * u(*rng))
      .Arc(radius, (u(*rng) < 0.5 ? -1 : 1) * 100.0 / radius)
      .chain();
}

class TrueK1 : public testing::TestWithParam<double> {};

TEST_P(TrueK1, IsFoundWithinItsDeviationAmongCurves) {
  const unsigned seed = 51;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  const PinholeCamera camera = Camera(GetParam());
  int found = 0, inside = 0;
  double square = 0.0, sigma = 0.0;
  constexpr int kTrials = 60;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<EdgeChain> chains;
    for (int k = 0; k < 14; ++k) {
      chains.push_back(Distorted(RandomLine(180 + 10 * k, &rng), camera, 0.15, &rng));
    }
    for (int k = 0; k < 8; ++k) {
      chains.push_back(Distorted(RandomCurve(&rng), camera, 0.15, &rng));
    }
    const auto estimate = EstimateRadialDistortion(chains, Camera(0.0), {});
    if (!estimate.ok()) continue;
    ++found;
    const double error = estimate->k1 - GetParam();
    square += error * error;
    sigma += estimate->k1_sigma;
    inside += std::abs(error) < 1.96 * estimate->k1_sigma;
  }
  std::printf("k1 %.3f: found %d of %d, rms error %.4f, mean sigma %.4f, in 95%% %.3f\n",
              GetParam(),
              found,
              kTrials,
              std::sqrt(square / found),
              sigma / found,
              1.0 * inside / found);
  EXPECT_GE(found, 0.95 * kTrials);
  EXPECT_GE(inside, 0.93 * found);
  EXPECT_LT(std::sqrt(square / found), 0.01);
  EXPECT_LT(sigma / found, 0.015);
}

INSTANTIATE_TEST_SUITE_P(K1, TrueK1, testing::Values(-0.1, -0.05, -0.02, 0.0, 0.02, 0.05));

TEST(EstimateRadialDistortion, OnlyK1OverFocalLengthSquaredIsSeen) {
  std::mt19937 rng(52);
  std::vector<EdgeChain> chains;
  for (int k = 0; k < 15; ++k) {
    chains.push_back(Distorted(RandomLine(250, &rng), Camera(-0.06), 0.1, &rng));
  }
  PinholeCamera longer = Camera(0.0);
  longer.focal_px *= 1.2;
  const auto a = EstimateRadialDistortion(chains, Camera(0.0), {});
  const auto b = EstimateRadialDistortion(chains, longer, {});
  ASSERT_TRUE(a.ok() && b.ok()) << a.status() << b.status();
  EXPECT_NEAR(b->k1, 1.44 * a->k1, 0.003);
  EXPECT_NEAR(b->k1_sigma, 1.44 * a->k1_sigma, 0.003);
}

TEST(EstimateRadialDistortion, RefusesWhereNoLineTells) {
  std::mt19937 rng(53);
  const auto code = [](const std::vector<EdgeChain>& chains) {
    return EstimateRadialDistortion(chains, Camera(0.0), {}).status().code();
  };
  constexpr auto kRefused = absl::StatusCode::kFailedPrecondition;
  EXPECT_EQ(code({}), kRefused);
  EXPECT_EQ(code({EdgeChain()}), kRefused);
  for (int trial = 0; trial < 20; ++trial) {
    SCOPED_TRACE(trial);
    const PinholeCamera camera = Camera(-0.08);
    std::vector<EdgeChain> small, radial, one;
    for (int k = 0; k < 40; ++k) {
      small.push_back(Distorted(RandomLine(40, &rng), camera, 0.15, &rng));
    }
    for (int k = 0; k < 12; ++k) {  // lines through the centre stay straight whatever k1 is
      radial.push_back(Distorted(
          ChainWalk({camera.cx, camera.cy}, 0.5 * k).Line(220).chain(), camera, 0.15, &rng));
    }
    one.push_back(Distorted(ChainWalk({20, 30}, 0.0).Line(600).chain(), camera, 0.15, &rng));
    EXPECT_EQ(code(small), kRefused);
    EXPECT_EQ(code(radial), kRefused);
    EXPECT_EQ(code(one), kRefused);
  }
}

TEST(EstimateRadialDistortion, CurvesAloneAreSeldomTakenForALens) {
  std::mt19937 rng(54);
  int taken = 0;
  for (int trial = 0; trial < 100; ++trial) {
    std::vector<EdgeChain> curves;
    for (int k = 0; k < 12; ++k) {
      curves.push_back(Distorted(RandomCurve(&rng), Camera(0.0), 0.15, &rng));
    }
    taken += EstimateRadialDistortion(curves, Camera(0.0), {}).ok();
  }
  std::printf("curves taken for a lens: %d of 100\n", taken);
  EXPECT_LE(taken, 2);
}

TEST(EstimateRadialDistortion, RefusesBadInput) {
  std::vector<EdgeChain> chains(1);
  chains[0].points.assign(100, Eigen::Vector2f(1, 1));
  const auto code = [&](const PinholeCamera& camera, const StraightnessOptions& options) {
    return EstimateRadialDistortion(chains, camera, options).status().code();
  };
  constexpr auto kBad = absl::StatusCode::kInvalidArgument;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(code(Camera(0.0), {}), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(code(PinholeCamera(), {}), kBad);
  PinholeCamera camera = Camera(0.0);
  camera.cx = nan;
  EXPECT_EQ(code(camera, {}), kBad);
  StraightnessOptions options;
  options.edge_rms_px = 0.0;
  EXPECT_EQ(code(Camera(0.0), options), kBad);
  options = {};
  options.min_agreement = nan;
  EXPECT_EQ(code(Camera(0.0), options), kBad);
  options = {};
  options.min_lines = 1;
  EXPECT_EQ(code(Camera(0.0), options), kBad);
  chains[0].points[50].x() = std::numeric_limits<float>::infinity();
  EXPECT_EQ(code(Camera(0.0), {}), kBad);
}

}  // namespace
}  // namespace horopter
