#include "server/vision/invariants/six_points.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

using Six = std::array<Eigen::Vector4d, 6>;

Six RandomSix(RandomSpace& space) {
  Six points;
  for (auto& p : points) p = space.Point();
  return points;
}

Six Transformed(const Six& points, const Eigen::Matrix4d& h, RandomSpace& space) {
  Six moved;
  for (int i = 0; i < 6; ++i) moved[i] = space.Scale() * h * points[i];
  return moved;
}

// The labeling of b that matches the stored one of a best, and how far it is off.
std::pair<const SixPointLabeling*, double> Best(const SixPointInvariants& a,
                                                const SixPointInvariants& b) {
  std::pair<const SixPointLabeling*, double> best{nullptr, INFINITY};
  for (const SixPointLabeling& labeling : b.labelings) {
    if (labeling.key.values.size() != a.labelings[0].key.values.size()) continue;
    const double off = (labeling.key.values - a.labelings[0].key.values).norm();
    if (off < best.second) best = {&labeling, off};
  }
  return best;
}

TEST(SixPointsTest, KeySurvivesCollineationsAndPermutationsAndGivesTheCorrespondence) {
  RandomSpace space(11);
  int kept = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    const Six points = RandomSix(space);
    const auto before = InvariantsOfSixPoints(points);
    if (!before) continue;
    ++kept;
    EXPECT_EQ(before->invariants, 3);
    EXPECT_EQ(before->labelings.size(), 12u);
    const Six moved = Transformed(points, space.Collineation(), space);
    std::array<int, 6> order;
    std::iota(order.begin(), order.end(), 0);
    std::shuffle(order.begin(), order.end(), space.rng());
    Six shuffled;
    for (int i = 0; i < 6; ++i) shuffled[i] = moved[order[i]];
    SixPointOptions loose;
    loose.min_ratio = 0.01;  // the gate may fall either way for a set right on it
    const auto after = InvariantsOfSixPoints(shuffled, {}, loose);
    ASSERT_TRUE(after) << "trial " << trial;
    const auto [labeling, off] = Best(*before, *after);
    ASSERT_LT(off, 1e-6) << "trial " << trial;
    for (int g = 0; g < 6; ++g) {
      EXPECT_EQ(order[labeling->groups[g][0]], before->labelings[0].groups[g][0]);
    }
  }
  // 67 % of general sets pass the gate.
  EXPECT_GT(kept, 1000);
}

TEST(SixPointsTest, DifferentSetsHaveDifferentKeys) {
  RandomSpace space(12);
  int close = 0, pairs = 0;
  for (int trial = 0; trial < 500; ++trial) {
    const auto a = InvariantsOfSixPoints(RandomSix(space));
    const auto b = InvariantsOfSixPoints(RandomSix(space));
    if (!a || !b) continue;
    ++pairs;
    close += Best(*a, *b).second < 0.05 ? 1 : 0;
  }
  EXPECT_GT(pairs, 100);
  EXPECT_LT(close, pairs / 50);
}

TEST(SixPointsTest, CoplanarFourMakeTheTwoOthersIndistinguishableAndLeaveTwoInvariants) {
  RandomSpace space(13);
  int kept = 0;
  for (int trial = 0; trial < 300; ++trial) {
    Six points = RandomSix(space);
    points[5] = 0.7 * points[0] - 0.9 * points[1] + 1.2 * points[2];  // 0, 1, 2, 5 in one plane
    const auto before = InvariantsOfSixPoints(points);
    if (!before) continue;
    ++kept;
    EXPECT_EQ(before->invariants, 2);
    EXPECT_EQ(before->labelings.size(), 10u);
    const auto& groups = before->labelings[0].groups;
    EXPECT_EQ(std::count(groups.begin(), groups.end(), std::vector<int>({3, 4})), 1);
    SixPointOptions loose;
    loose.min_ratio = 0.01;
    const auto after =
        InvariantsOfSixPoints(Transformed(points, space.Collineation(), space), {}, loose);
    ASSERT_TRUE(after);
    EXPECT_LT(Best(*before, *after).second, 1e-5);
  }
  EXPECT_GT(kept, 100);
}

TEST(SixPointsTest, RejectsFiveAndSixCoplanarPointsRepeatedPointsAndNan) {
  RandomSpace space(14);
  Six flat = RandomSix(space);
  for (auto& p : flat) p.z() = 0.0;
  EXPECT_FALSE(InvariantsOfSixPoints(flat));
  flat[5].z() = 1.0;
  EXPECT_FALSE(InvariantsOfSixPoints(flat));
  Six bad = RandomSix(space);
  bad[2].x() = NAN;
  EXPECT_FALSE(InvariantsOfSixPoints(bad));
  bad = RandomSix(space);
  bad[2] = bad[3] = bad[4];
  EXPECT_FALSE(InvariantsOfSixPoints(bad));
}

TEST(SixPointsTest, CubeCornersNeverHaveThreeInvariants) {
  // Of a cube's 28 six-tuples 16 have none and 12 one.
  std::vector<Eigen::Vector4d> corners;
  for (int i = 0; i < 8; ++i) {
    corners.emplace_back(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1, 1.0);
  }
  int tuples[4] = {0, 0, 0, 0};
  for (int a = 0; a < 8; ++a) {
    for (int b = a + 1; b < 8; ++b) {
      Six six;
      int n = 0;
      for (int i = 0; i < 8; ++i) {
        if (i != a && i != b) six[n++] = corners[i];
      }
      const auto found = InvariantsOfSixPoints(six);
      ++tuples[found ? found->invariants : 0];
    }
  }
  EXPECT_EQ(tuples[0], 16);
  EXPECT_EQ(tuples[1], 12);
}

TEST(SixPointsTest, CovarianceIsWhatNoiseShows) {
  RandomSpace space(15);
  constexpr double kSigma = 1e-4;
  int checked = 0;
  for (int trial = 0; trial < 20 && checked < 5; ++trial) {
    const Six points = RandomSix(space);
    Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(24, 24);
    for (int i = 0; i < 24; ++i) covariance(i, i) = i % 4 == 3 ? 0.0 : kSigma * kSigma;
    const auto stated = InvariantsOfSixPoints(points, covariance, {.min_ratio = 0.1});
    if (!stated) continue;
    ++checked;
    std::vector<Eigen::VectorXd> samples;
    for (int k = 0; k < 3000; ++k) {
      Six noisy = points;
      for (auto& p : noisy) p.head<3>() += kSigma * space.Noise(3);
      const auto found = InvariantsOfSixPoints(noisy, {}, {.min_ratio = 0.01});
      ASSERT_TRUE(found);
      samples.push_back(Best(*stated, *found).first->key.values);
    }
    EXPECT_LT(CovarianceError(samples, stated->labelings[0].key.covariance), 0.15);
  }
  EXPECT_EQ(checked, 5);
}

TEST(SixPointsTest, AxisInvariantsMatchPermutedSetsThroughTheVotes) {
  RandomSpace space(16);
  int right = 0, trials = 200;
  for (int trial = 0; trial < trials; ++trial) {
    const Six points = RandomSix(space);
    const Six moved = Transformed(points, space.Collineation(), space);
    std::array<int, 6> order;
    std::iota(order.begin(), order.end(), 0);
    std::shuffle(order.begin(), order.end(), space.rng());
    Six shuffled;
    for (int i = 0; i < 6; ++i) shuffled[order[i]] = moved[i];
    right += MatchByAxes(AxisInvariants(points), AxisInvariants(shuffled), 1e-6) == order;
  }
  EXPECT_GT(right, trials * 9 / 10);
}

}  // namespace
}  // namespace horopter
