#include "server/vision/invariants/cross_ratio.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

std::array<Eigen::Vector2d, 4> RandomPoints(RandomSpace& space) {
  std::array<Eigen::Vector2d, 4> t;
  for (auto& p : t) p = {space.Normal(), space.Normal()};
  return t;
}

TEST(CrossRatioTest, IsInvariantUnderCollineationsOfTheLine) {
  RandomSpace space(1);
  for (int trial = 0; trial < 1000; ++trial) {
    const auto t = RandomPoints(space);
    const Eigen::Matrix2d h{{space.Normal(), space.Normal()}, {space.Normal(), space.Normal()}};
    if (std::abs(h.determinant()) < 0.1) continue;
    const CrossRatio before = CrossRatioOf(t[0], t[1], t[2], t[3]);
    const CrossRatio after = CrossRatioOf(
        space.Scale() * h * t[0], h * t[1], space.Scale() * h * t[2], space.Scale() * h * t[3]);
    EXPECT_NEAR(std::sin(0.5 * (StereographicAngle(before) - StereographicAngle(after))), 0, 1e-8);
  }
}

TEST(CrossRatioTest, FoldedFormIgnoresTheOrderAndKeepsTheRest) {
  RandomSpace space(2);
  for (int trial = 0; trial < 1000; ++trial) {
    const auto t = RandomPoints(space);
    std::array<int, 4> order{0, 1, 2, 3};
    const CrossRatio lambda = CrossRatioOf(t[0], t[1], t[2], t[3]);
    do {
      const CrossRatio permuted = CrossRatioOf(t[order[0]], t[order[1]], t[order[2]], t[order[3]]);
      EXPECT_NEAR(FoldedAngle(permuted), FoldedAngle(lambda), 1e-8);
    } while (std::next_permutation(order.begin(), order.end()));
    // 27 / (4 j) = (1 + cos 3 phi) / 2 ties it to the classical form.
    const double n = lambda.numerator, d = lambda.denominator, top = n * n - n * d + d * d;
    const double j = top * top * top / std::pow(n * d * (d - n), 2);
    EXPECT_NEAR(27.0 / (4.0 * j), 0.5 * (1.0 + std::cos(3.0 * StereographicAngle(lambda))), 1e-8);
  }
}

TEST(CrossRatioTest, CoincidencesAndHarmonicSetsAreTheEndsOfTheFoldedScale) {
  for (const CrossRatio& lambda : {CrossRatio{0, 1}, CrossRatio{1, 1}, CrossRatio{1, 0}}) {
    EXPECT_NEAR(FoldedAngle(lambda), M_PI / 3, 1e-12);
  }
  for (const double lambda : {-1.0, 0.5, 2.0}) EXPECT_NEAR(FoldedAngle({lambda, 1}), 0.0, 1e-12);
}

}  // namespace
}  // namespace horopter
