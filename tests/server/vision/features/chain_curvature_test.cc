#include "server/vision/features/chain_curvature.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/server/vision/features/synthetic_chains.h"

namespace horopter {
namespace {

constexpr CurvatureMethod kMethods[] = {CurvatureMethod::kEllipse, CurvatureMethod::kCircle};

std::vector<double> Curvature(const std::vector<Eigen::Vector2f>& points,
                              CurvatureMethod method,
                              bool closed = false,
                              int half_width = 5) {
  const auto result = ChainCurvature(points, closed, {method, half_width});
  EXPECT_TRUE(result.ok()) << result.status();
  return result.value_or(std::vector<double>(points.size(), std::nan("")));
}

SyntheticChain Circle(double radius, double turn) {
  return ChainWalk({100, 80}, 0.7).Arc(radius, turn).chain();
}

TEST(ChainCurvature, OfACircleIsTheInverseOfItsRadiusSignedByTheTurn) {
  std::mt19937 rng(1);
  for (double radius : {6.0, 15.0, 60.0, 400.0}) {
    for (double turn : {2.0, -2.0}) {
      const auto points = Circle(radius, turn).Noisy(0.0, &rng);
      for (CurvatureMethod method : kMethods) {
        for (double kappa : Curvature(points, method)) {
          EXPECT_NEAR(kappa, std::copysign(1.0 / radius, turn), 0.02 / radius + 2e-4);
        }
      }
    }
  }
}

TEST(ChainCurvature, OfALineIsZeroAndSmallUnderNoise) {
  std::mt19937 rng(2);
  for (double heading : {0.0, 0.3, 1.5707963, 2.5}) {
    const SyntheticChain line = ChainWalk({50, 60}, heading).Line(200).chain();
    for (CurvatureMethod method : kMethods) {
      for (double kappa : Curvature(line.Noisy(0.0, &rng), method)) EXPECT_NEAR(kappa, 0.0, 3e-4);
      double largest = 0.0;
      for (double kappa : Curvature(line.Noisy(0.2, &rng), method)) {
        largest = std::max(largest, std::abs(kappa));
      }
      // No end of a thin ellipse gets through: 1.5 parabolas over 0.4 px of deviation at most.
      EXPECT_LT(largest, 0.15);
    }
  }
}

TEST(ChainCurvature, MovedMomentsEqualMomentsSummedAnewFarAlongALongChain) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  ChainWalk walk({10, 10}, 0.0);
  for (int k = 0; k < 300; ++k) walk.Line(20 + 10 * u(rng)).Arc(40 + 20 * u(rng), 1.5 * u(rng));
  const auto points = walk.chain().Noisy(0.1, &rng);
  const auto whole = Curvature(points, CurvatureMethod::kEllipse);
  for (size_t i = 5; i + 6 < points.size(); i += 97) {
    const std::vector<Eigen::Vector2f> window(points.begin() + i - 5, points.begin() + i + 6);
    EXPECT_NEAR(Curvature(window, CurvatureMethod::kEllipse)[5], whole[i], 1e-6) << i;
  }
}

TEST(ChainCurvature, ReversingNegatesRotatingAndMovingLeaveIt) {
  std::mt19937 rng(4);
  const SyntheticChain chain =
      ChainWalk({60, 60}, 0.2).Line(30).Turn(1.0).Line(30).Arc(20, -2.0).Line(20).chain();
  const auto points = chain.Noisy(0.1, &rng);
  auto reversed = points;
  std::reverse(reversed.begin(), reversed.end());
  std::vector<Eigen::Vector2f> moved;
  Eigen::Matrix2f R;
  R << std::cos(0.8f), -std::sin(0.8f), std::sin(0.8f), std::cos(0.8f);
  for (const Eigen::Vector2f& p : points) moved.push_back(R * p + Eigen::Vector2f(30, 70));
  for (CurvatureMethod method : kMethods) {
    const auto kappa = Curvature(points, method), back = Curvature(reversed, method),
               elsewhere = Curvature(moved, method);
    for (size_t i = 0; i < kappa.size(); ++i) {
      EXPECT_NEAR(back[kappa.size() - 1 - i], -kappa[i], 1e-4);
      EXPECT_NEAR(elsewhere[i], kappa[i], 2e-3);  // float coordinates
    }
  }
}

TEST(ChainCurvature, AClosedChainHasNoBeginning) {
  std::mt19937 rng(5);
  const auto points = Circle(12.0, 2 * M_PI).Noisy(0.1, &rng);
  auto shifted = points;
  std::rotate(shifted.begin(), shifted.begin() + 31, shifted.end());
  for (CurvatureMethod method : kMethods) {
    auto kappa = Curvature(points, method, true);
    std::rotate(kappa.begin(), kappa.begin() + 31, kappa.end());
    const auto other = Curvature(shifted, method, true);
    for (size_t i = 0; i < kappa.size(); ++i) EXPECT_NEAR(kappa[i], other[i], 1e-6);
  }
}

TEST(ChainCurvature, ACornersPeakIsAtTheCornerAndGrowsWithItsAngle) {
  std::mt19937 rng(6);
  for (CurvatureMethod method : kMethods) {
    double lower = 0.02;
    for (double degrees : {20.0, 40.0, 60.0, 90.0}) {
      const SyntheticChain chain =
          ChainWalk({20, 20}, 0.3).Line(30).Turn(degrees * M_PI / 180).Line(30).chain();
      const auto kappa = Curvature(chain.Noisy(0.0, &rng), method);
      const auto peak = std::max_element(kappa.begin(), kappa.end());
      EXPECT_NEAR(peak - kappa.begin(), 30, 1);
      EXPECT_GT(*peak, lower);
      lower = *peak;
    }
  }
}

// The ellipse is pulled towards the points of a short noisy arc: what the thesis calls averaging.
TEST(ChainCurvature, UnderNoiseEllipseAndCircleAgreeUpToTheEllipsesPull) {
  for (double noise : {0.05, 0.1}) {
    std::mt19937 rng(7);
    std::vector<double> ellipse = Curvature(Circle(12.0, 5.0).Noisy(noise, &rng),
                                            CurvatureMethod::kEllipse),
                        circle = Curvature(Circle(12.0, 5.0).Noisy(noise, &rng),
                                           CurvatureMethod::kCircle);
    std::nth_element(ellipse.begin(), ellipse.begin() + ellipse.size() / 2, ellipse.end());
    std::nth_element(circle.begin(), circle.begin() + circle.size() / 2, circle.end());
    EXPECT_NEAR(circle[circle.size() / 2], 1.0 / 12.0, 0.01) << noise;
    EXPECT_GT(ellipse[ellipse.size() / 2], 0.5 / 12.0) << noise;
    EXPECT_LT(ellipse[ellipse.size() / 2], 1.1 / 12.0) << noise;
  }
}

TEST(ChainCurvature, AwkwardChainsGiveFiniteValues) {
  std::mt19937 rng(8);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  for (CurvatureMethod method : kMethods) {
    for (bool closed : {false, true}) {
      for (int n : {0, 1, 2, 4, 5, 6, 11, 12}) {
        std::vector<Eigen::Vector2f> same(n, Eigen::Vector2f(3, 4)), random, steps, huge;
        for (int i = 0; i < n; ++i) {
          random.emplace_back(5 * u(rng), 5 * u(rng));
          steps.emplace_back(i % 2, i / 2);
          huge.emplace_back(1e30f * u(rng), 1e30f * u(rng));
        }
        for (const auto& points : {same, random, steps, huge}) {
          const auto kappa = Curvature(points, method, closed);
          ASSERT_EQ(kappa.size(), points.size());
          for (double k : kappa) EXPECT_LE(std::abs(k), 1.0);  // false for NaN
        }
      }
    }
  }
}

TEST(ChainCurvature, RefusesBadOptionsAndPointsThatAreNotFinite) {
  std::vector<Eigen::Vector2f> points(20, Eigen::Vector2f(1, 1));
  EXPECT_EQ(ChainCurvature(points, false, {CurvatureMethod::kEllipse, 1}).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ChainCurvature(points, false, {CurvatureMethod::kEllipse, 201}).status().code(),
            absl::StatusCode::kInvalidArgument);
  points[7].x() = std::numeric_limits<float>::quiet_NaN();
  const auto status = ChainCurvature(points, false, {}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(std::string(status.message()).find("point 7"), std::string::npos);
}

}  // namespace
}  // namespace horopter
