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
    EXPECT_NEAR(27.0 / (4.0 * JInvariant(lambda)),
                0.5 * (1.0 + std::cos(3.0 * StereographicAngle(lambda))),
                1e-8);
  }
}

TEST(CrossRatioTest, CoincidencesAndHarmonicSetsAreTheEndsOfTheFoldedScale) {
  for (const CrossRatio& lambda : {CrossRatio{0, 1}, CrossRatio{1, 1}, CrossRatio{1, 0}}) {
    EXPECT_NEAR(FoldedAngle(lambda), M_PI / 3, 1e-12);
  }
  for (const double lambda : {-1.0, 0.5, 2.0}) EXPECT_NEAR(FoldedAngle({lambda, 1}), 0.0, 1e-12);
}

class CollinearFormTest : public testing::TestWithParam<CrossRatioForm> {};

TEST_P(CollinearFormTest, IgnoresOrdersScalesAndCollineations) {
  RandomSpace space(3);
  for (int trial = 0; trial < 300; ++trial) {
    auto t = RandomPoints(space);
    const auto before = FourCollinearPoints(t, {}, {.form = GetParam(), .min_ratio = 0.1});
    if (!before) continue;
    const Eigen::Matrix2d h{{space.Normal(), space.Normal()}, {space.Normal(), space.Normal()}};
    if (std::abs(h.determinant()) < 0.1) continue;
    for (auto& p : t) p = space.Scale() * h * p;
    std::shuffle(t.begin(), t.end(), space.rng());
    const auto after = FourCollinearPoints(t, {}, {.form = GetParam(), .min_ratio = 0.0});
    ASSERT_TRUE(after);
    EXPECT_NEAR(after->values(0), before->values(0), 1e-6 * (1.0 + before->values(0)));
  }
}

TEST_P(CollinearFormTest, CovarianceIsWhatNoiseShows) {
  RandomSpace space(4);
  constexpr double kSigma = 1e-4;
  int checked = 0;
  for (int trial = 0; trial < 200 && checked < 5; ++trial) {
    const auto t = RandomPoints(space);
    const auto stated = FourCollinearPoints(t,
                                            kSigma * kSigma * Eigen::MatrixXd::Identity(8, 8),
                                            {.form = GetParam(), .min_ratio = 0.2});
    if (!stated) continue;
    // At a kink of the folded angle, or where the cosine turns, no first order holds.
    const double angle = FoldedAngle(CrossRatioOf(t[0], t[1], t[2], t[3]));
    if (angle < 0.1 || angle > M_PI / 3 - 0.1) continue;
    ++checked;
    std::vector<Eigen::VectorXd> samples;
    for (int k = 0; k < 4000; ++k) {
      auto noisy = t;
      for (auto& p : noisy) p += kSigma * space.Noise(2);
      samples.push_back(FourCollinearPoints(noisy, {}, {.form = GetParam()})->values);
    }
    EXPECT_LT(CovarianceError(samples, stated->covariance), 0.15);
  }
  EXPECT_EQ(checked, 5);
}

TEST_P(CollinearFormTest, RejectsPointsThatNearlyCoincide) {
  RandomSpace space(5);
  auto t = RandomPoints(space);
  t[2] = -3.0 * t[0] + 1e-4 * t[1];
  EXPECT_FALSE(FourCollinearPoints(t, {}, {.form = GetParam()}));
  t[2].x() = NAN;
  EXPECT_FALSE(FourCollinearPoints(t, {}, {.form = GetParam()}));
}

INSTANTIATE_TEST_SUITE_P(All,
                         CollinearFormTest,
                         testing::Values(CrossRatioForm::kFoldedAngle,
                                         CrossRatioForm::kPeriodicCosine,
                                         CrossRatioForm::kJInvariant));

}  // namespace
}  // namespace horopter
