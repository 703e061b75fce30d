#include "server/index/x_tree.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "tests/server/index/brute_force.h"

namespace horopter {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

std::vector<double> RandomPoints(int n, int dimensions, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> uniform;
  std::vector<double> points(static_cast<size_t>(n) * dimensions);
  for (double& x : points) x = uniform(rng);
  return points;
}

std::vector<int64_t> Iota(int n) {
  std::vector<int64_t> ids(n);
  std::iota(ids.begin(), ids.end(), 0);
  return ids;
}

std::span<const double> Row(const std::vector<double>& points, int i, int dimensions) {
  return std::span<const double>(points).subspan(static_cast<size_t>(i) * dimensions, dimensions);
}

TEST(XTreeTest, EmptyTreeAnswersEveryQueryWithNothing) {
  XTree tree = XTree::Create({.dimensions = 2}).value();
  const std::vector<double> origin{0.0, 0.0};
  EXPECT_TRUE(tree.view().Box(origin, origin).empty());
  EXPECT_TRUE(tree.view().Nearest(origin, 3).empty());
  EXPECT_TRUE(tree.view().Radius(origin, 1.0).empty());
  EXPECT_EQ(tree.Delete(origin, 1).code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(tree.view().CheckInvariants().ok());
  EXPECT_EQ(tree.view().Memory().height, 1);
}

TEST(XTreeTest, RefusesWhatIsNoPointOfItsSpace) {
  XTree tree = XTree::Create({.dimensions = 2}).value();
  EXPECT_EQ(tree.Insert(std::vector<double>{1.0}, 1).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(tree.Insert(std::vector<double>{1.0, kNan}, 1).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(tree.InsertBox(std::vector<double>{0, 0}, std::vector<double>{1, 1}, 1).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(tree.size(), 0);
  EXPECT_FALSE(XTree::Create({.dimensions = 0}).ok());
  EXPECT_FALSE(XTree::Create({.dimensions = 2, .leaf_capacity = 1}).ok());
  const std::vector<int64_t> ids{1};
  EXPECT_FALSE(XTree::BulkLoad({.dimensions = 2}, std::vector<double>{1.0}, ids).ok());
}

TEST(XTreeTest, RefusesAnEllipsoidThatIsNone) {
  XTree tree = XTree::Create({.dimensions = 2}).value();
  Ellipsoid e{Eigen::Vector2d::Zero(), Eigen::Matrix2d::Zero(), 1.0};
  EXPECT_EQ(tree.view().Inside(e).status().code(), absl::StatusCode::kInvalidArgument);
  e.covariance = Eigen::Matrix3d::Identity();
  EXPECT_EQ(tree.view().Inside(e).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(XTreeTest, BulkLoadedTreeHoldsEverythingAndIsSound) {
  for (const int n : {0, 1, 22, 24, 25, 1000, 20000}) {
    for (const int dimensions : {1, 3, 16}) {
      const std::vector<double> points = RandomPoints(n, dimensions, 7);
      const XTree tree = XTree::BulkLoad({.dimensions = dimensions}, points, Iota(n)).value();
      EXPECT_TRUE(tree.view().CheckInvariants().ok()) << tree.view().CheckInvariants();
      std::vector<int64_t> seen;
      tree.view().ForEach([&](int64_t id, std::span<const double> low, std::span<const double>) {
        seen.push_back(id);
        EXPECT_TRUE(std::equal(
            low.begin(), low.end(), Row(points, static_cast<int>(id), dimensions).begin()));
      });
      EXPECT_EQ(Sorted(seen), Iota(n));
    }
  }
}

std::vector<int64_t> StorageOrder(const XTree& tree) {
  std::vector<int64_t> ids;
  tree.view().ForEach([&](int64_t id, auto, auto) { ids.push_back(id); });
  return ids;
}

TEST(XTreeTest, PackedBoxesAreSoundAndTheSameForAnyNumberOfThreads) {
  constexpr int kCount = 150000, kDimensions = 4;
  const std::vector<double> points = RandomPoints(kCount, kDimensions, 13);
  std::vector<float> lows(points.begin(), points.end()), highs = lows;
  for (size_t i = 0; i < highs.size(); ++i) highs[i] += 0.001f * static_cast<float>(i % 7);
  // Many equal ones, so that ties decide where pieces end.
  for (size_t i = 0; i < lows.size() / 3; ++i) lows[i] = highs[i] = 0.25f;
  const XTreeOptions options{.dimensions = kDimensions, .boxes = true};
  const XTree one = XTree::BulkLoadBoxes(options, lows, highs, Iota(kCount), 1).value();
  const XTree four = XTree::BulkLoadBoxes(options, lows, highs, Iota(kCount), 4).value();
  EXPECT_TRUE(one.view().CheckInvariants().ok()) << one.view().CheckInvariants();
  EXPECT_EQ(StorageOrder(one), StorageOrder(four));
  EXPECT_EQ(Sorted(StorageOrder(one)), Iota(kCount));
  const std::vector<double> low(kDimensions, 0.3), high(kDimensions, 0.6);
  std::vector<int64_t> expected;
  for (int i = 0; i < kCount; ++i) {
    bool meets = true;
    for (size_t d = 0; d < kDimensions; ++d) {
      const size_t at = static_cast<size_t>(i) * kDimensions + d;
      meets &= lows[at] <= high[d] && highs[at] >= low[d];
    }
    if (meets) expected.push_back(i);
  }
  EXPECT_FALSE(expected.empty());
  EXPECT_EQ(Sorted(four.view().Box(low, high)), expected);
}

TEST(XTreeTest, BulkLoadedTreeGrowsAndShrinksToNothing) {
  constexpr int kCount = 3000, kDimensions = 3;
  const std::vector<double> points = RandomPoints(2 * kCount, kDimensions, 8);
  const std::vector<double> first(points.begin(), points.begin() + kCount * kDimensions);
  XTree tree = XTree::BulkLoad({.dimensions = kDimensions}, first, Iota(kCount)).value();
  for (int i = kCount; i < 2 * kCount; ++i) {
    ASSERT_TRUE(tree.Insert(Row(points, i, kDimensions), i).ok());
  }
  ASSERT_TRUE(tree.view().CheckInvariants().ok()) << tree.view().CheckInvariants();
  for (int i = 0; i < 2 * kCount; ++i) {
    ASSERT_TRUE(tree.Delete(Row(points, i, kDimensions), i).ok());
  }
  EXPECT_EQ(tree.size(), 0);
  EXPECT_TRUE(tree.view().CheckInvariants().ok());
}

// A point query on overlap-free data follows one path.
TEST(XTreeTest, PointQueryOnPackedPointsVisitsFewNodes) {
  constexpr int kCount = 20000, kDimensions = 6;
  const std::vector<double> points = RandomPoints(kCount, kDimensions, 9);
  const XTree tree = XTree::BulkLoad({.dimensions = kDimensions}, points, Iota(kCount)).value();
  for (int i = 0; i < kCount; i += 997) {
    QueryStats stats;
    const std::span<const double> p = Row(points, i, kDimensions);
    EXPECT_EQ(tree.view().Box(p, p, &stats), std::vector<int64_t>{i});
    EXPECT_LE(stats.accesses(), 2 * tree.view().Memory().height);
  }
}

// The cost of a query may grow with the logarithm of the number of keys and with its answers: what
// is read beyond the nodes that hold the answers is at most a few nodes a level. Each tree holds
// the smaller one's points and more of the same density, so that the query has the same answers.
TEST(XTreeTest, NodesReadGrowWithTheHeightAndTheAnswersOnly) {
  constexpr int kDimensions = 3;
  constexpr double kPerUnit = 30.0;  // points in a unit cube: about a leaf
  for (const bool packed : {true, false}) {
    double most_extra = 0.0;
    for (const int count : {1000, 8000, 64000, 512000}) {
      if (!packed && count > 64000) continue;  // takes long to insert
      std::vector<double> points = RandomPoints(count, kDimensions, 14);
      const double side = std::cbrt(count / kPerUnit);
      for (double& x : points) x *= side;
      XTree tree = XTree::Create({.dimensions = kDimensions}).value();
      if (packed) {
        tree = XTree::BulkLoad({.dimensions = kDimensions}, points, Iota(count)).value();
      } else {
        for (int i = 0; i < count; ++i) {
          ASSERT_TRUE(tree.Insert(Row(points, i, kDimensions), i).ok());
        }
      }
      const int height = tree.view().Memory().height;
      QueryStats stats;
      size_t answers = 0;
      constexpr int kQueries = 200;
      for (int q = 0; q < kQueries; ++q) {
        const auto center = Row(points, q * (count / kQueries), kDimensions);
        Ellipsoid ball;
        ball.center = Eigen::Map<const Eigen::VectorXd>(center.data(), kDimensions);
        ball.covariance = 0.09 * Eigen::MatrixXd::Identity(kDimensions, kDimensions);
        ball.gate = 1.0;
        answers += tree.view().Inside(ball, &stats).value().size();
      }
      EXPECT_EQ(stats.scans, 0);
      const double per_query = static_cast<double>(stats.accesses()) / kQueries;
      // A ball of 0.3 units meets up to eight neighbouring leaves and as many nodes of each level.
      EXPECT_LT(per_query, 8.0 * height) << count << " points, packed " << packed;
      EXPECT_GE(answers, static_cast<size_t>(kQueries));
      most_extra = std::max(most_extra, per_query / height);
      std::printf("%d points, height %d: %.1f nodes, %.1f answers a query\n",
                  count,
                  height,
                  per_query,
                  static_cast<double>(answers) / kQueries);
    }
    EXPECT_GT(most_extra, 0.5);  // they are counted at all
  }
}

// In many dimensions the X-tree makes supernodes where an R*-tree would split with overlap; that
// must not cost point queries.
TEST(XTreeTest, MakesSupernodesAndReadsNoMoreThanTheRStarTreeInManyDimensions) {
  constexpr int kCount = 20000, kDimensions = 16;
  const std::vector<double> points = RandomPoints(kCount, kDimensions, 10);
  QueryStats accesses[2];
  for (const IndexMode mode : {IndexMode::kXTree, IndexMode::kRStarTree}) {
    XTree tree = XTree::Create({.dimensions = kDimensions,
                                .mode = mode,
                                .leaf_capacity = 30,
                                .directory_capacity = 15})
                     .value();
    for (int i = 0; i < kCount; ++i) ASSERT_TRUE(tree.Insert(Row(points, i, kDimensions), i).ok());
    if (mode == IndexMode::kRStarTree) {
      EXPECT_EQ(tree.view().Memory().supernodes, 0);
    }
    for (int i = 0; i < kCount; i += 199) {
      const std::span<const double> p = Row(points, i, kDimensions);
      EXPECT_EQ(tree.view().Box(p, p, &accesses[static_cast<int>(mode)]).size(), 1u);
    }
  }
  EXPECT_LT(accesses[0].accesses(), 1.2 * accesses[1].accesses());
}

// Boxes overlap whatever the split; an X-tree then makes supernodes and an R*-tree does not.
TEST(XTreeTest, OverlappingBoxesMakeSupernodes) {
  constexpr int kCount = 5000, kDimensions = 8;
  const std::vector<double> lows = RandomPoints(kCount, kDimensions, 12);
  std::vector<double> highs = lows;
  for (double& x : highs) x += 0.5;
  for (const IndexMode mode : {IndexMode::kXTree, IndexMode::kRStarTree}) {
    XTree tree = XTree::Create({.dimensions = kDimensions,
                                .boxes = true,
                                .mode = mode,
                                .leaf_capacity = 12,
                                .directory_capacity = 12})
                     .value();
    for (int i = 0; i < kCount; ++i) {
      ASSERT_TRUE(tree.InsertBox(Row(lows, i, kDimensions), Row(highs, i, kDimensions), i).ok());
    }
    ASSERT_TRUE(tree.view().CheckInvariants().ok()) << tree.view().CheckInvariants();
    EXPECT_EQ(tree.view().Memory().supernodes > 0, mode == IndexMode::kXTree);
  }
}

TEST(XTreeTest, WideQueryTurnsIntoAScanWithTheSameAnswer) {
  constexpr int kCount = 20000, kDimensions = 3;
  const std::vector<double> points = RandomPoints(kCount, kDimensions, 11);
  const XTree tree = XTree::BulkLoad({.dimensions = kDimensions}, points, Iota(kCount)).value();
  QueryStats stats;
  const std::vector<double> low(kDimensions, -1.0), high(kDimensions, 2.0);
  EXPECT_EQ(Sorted(tree.view().Box(low, high, &stats)), Iota(kCount));
  EXPECT_EQ(stats.scans, 1);
}

}  // namespace
}  // namespace horopter
