#include "server/vision/invariants/six_point_sets.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <set>

#include "tests/support/random.h"

namespace horopter {
namespace {

std::vector<Eigen::Vector3d> RandomPoints(int n, unsigned seed) {
  Random random(seed);
  std::vector<Eigen::Vector3d> out;
  for (int i = 0; i < n; ++i) out.push_back({random.Normal(), random.Normal(), random.Normal()});
  return out;
}

double SmallestDeterminant(const std::vector<Eigen::Vector3d>& points,
                           const std::array<int, 6>& set) {
  double smallest = INFINITY;
  for (int i = 0; i < 6; ++i) {
    for (int j = i + 1; j < 6; ++j) {
      Eigen::Matrix4d four;
      for (int k = 0, n = 0; k < 6; ++k) {
        if (k != i && k != j) four.col(n++) = points[set[k]].homogeneous();
      }
      smallest = std::min(smallest, std::abs(four.determinant()));
    }
  }
  return smallest;
}

TEST(WellSpreadSets, AreTheBestOfAllByTheirSmallestDeterminant) {
  const std::vector<Eigen::Vector3d> points = RandomPoints(11, 1);
  const auto all = WellSpreadSets(points, 1000000);
  ASSERT_EQ(all.size(), 462u);
  // One affine frame for all sets: the order is that of the plain determinants.
  for (std::size_t i = 1; i < all.size(); ++i) {
    EXPECT_GE(SmallestDeterminant(points, all[i - 1]),
              SmallestDeterminant(points, all[i]) * (1.0 - 1e-5));
  }
  const auto best = WellSpreadSets(points, 50);
  EXPECT_TRUE(std::equal(best.begin(), best.end(), all.begin()));
}

TEST(WellSpreadSets, DoNotChangeUnderAffineMapsAndLittleUnderMildCollineations) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const std::vector<Eigen::Vector3d> points = RandomPoints(14, seed);
    Random random(seed + 100);
    Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 4; ++k) H(i, k) += 0.3 * random.Normal();
    }
    if (std::abs(H.determinant()) < 0.1) continue;
    const auto before = WellSpreadSets(points, 300);
    const std::set<std::array<int, 6>> kept(before.begin(), before.end());
    for (const double bend : {0.0, 0.03}) {
      for (int k = 0; k < 3; ++k) H(3, k) = bend * random.Uniform(-1.0, 1.0);
      std::vector<Eigen::Vector3d> moved;
      for (const auto& x : points) moved.push_back((H * x.homogeneous()).hnormalized());
      int same = 0;
      for (const auto& set : WellSpreadSets(moved, 300)) same += kept.count(set) > 0;
      EXPECT_GE(same, bend == 0.0 ? 298 : 200);
    }
  }
}

TEST(WellSpreadSets, OfManyPointsAreDrawnAndTheSameEachTime) {
  const std::vector<Eigen::Vector3d> points = RandomPoints(80, 3);
  SixPointSetOptions options;
  options.max_looked_at = 5000;
  const auto sets = WellSpreadSets(points, 200, options);
  ASSERT_EQ(sets.size(), 200u);
  EXPECT_EQ(sets, WellSpreadSets(points, 200, options));
  EXPECT_EQ(std::set(sets.begin(), sets.end()).size(), 200u);
  for (const auto& set : sets) {
    for (int k = 1; k < 6; ++k) EXPECT_LT(set[k - 1], set[k]);
    EXPECT_LT(set[5], 80);
  }
}

TEST(WellSpreadSets, OfFlatFewOrUnusablePointsAreNone) {
  std::vector<Eigen::Vector3d> points = RandomPoints(10, 4);
  EXPECT_TRUE(WellSpreadSets(std::span(points).first(5), 10).empty());
  EXPECT_TRUE(WellSpreadSets(points, 0).empty());
  std::vector<Eigen::Vector3d> flat = points, broken = points;
  for (auto& x : flat) x.z() = 0.5 * x.x() - x.y();
  EXPECT_TRUE(WellSpreadSets(flat, 10).empty());
  broken[3].x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(WellSpreadSets(broken, 10).empty());
}

}  // namespace
}  // namespace horopter
