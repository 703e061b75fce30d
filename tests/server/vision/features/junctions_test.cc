#include "server/vision/features/junctions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace horopter {
namespace {

Segment Piece(double x0, double y0, double x1, double y1) {
  Segment s;
  s.start = {x0, y0};
  s.end = {x1, y1};
  s.contrast = 50.0;
  return s;
}

TEST(FindJunctions, TwoEndsMeetAtTheIntersectionOfTheirLines) {
  // Both stop short of (100, 100).
  const std::vector<Junction> junctions =
      FindJunctions({Piece(20, 100, 95, 100), Piece(100, 106, 100, 180)}, FeatureOptions());
  ASSERT_EQ(junctions.size(), 1u);
  EXPECT_LT((junctions[0].point - Eigen::Vector2d(100, 100)).norm(), 1e-9);
  ASSERT_EQ(junctions[0].ends.size(), 2u);
  for (const Junction::End& end : junctions[0].ends) {
    EXPECT_FALSE(end.interior);
    EXPECT_EQ(end.at_start, end.segment == 1);
  }
}

TEST(FindJunctions, ThreeLinesGiveOneLeastSquaresPoint) {
  // A trihedral corner whose third line misses the point of the others by 1 px.
  const std::vector<Junction> junctions =
      FindJunctions({Piece(20, 100, 97, 100), Piece(100, 103, 100, 180), Piece(102, 97, 160, 39)},
                    FeatureOptions());
  ASSERT_EQ(junctions.size(), 1u);
  EXPECT_EQ(junctions[0].ends.size(), 3u);
  EXPECT_LT((junctions[0].point - Eigen::Vector2d(100, 100)).norm(), 1.0);
  EXPECT_GT(junctions[0].rms_px, 0.0);
  EXPECT_LT(junctions[0].rms_px, 1.0);
}

TEST(FindJunctions, EndOnTheMiddleOfAnotherIsATee) {
  const std::vector<Junction> junctions =
      FindJunctions({Piece(0, 100, 200, 100), Piece(90, 105, 90, 180)}, FeatureOptions());
  ASSERT_EQ(junctions.size(), 1u);
  EXPECT_LT((junctions[0].point - Eigen::Vector2d(90, 100)).norm(), 1e-9);
  int interior = 0;
  for (const Junction::End& end : junctions[0].ends) {
    interior += end.interior ? 1 : 0;
    EXPECT_EQ(end.interior, end.segment == 0);
  }
  EXPECT_EQ(interior, 1);
}

TEST(FindJunctions, RespectsGapShareAndAngleLimits) {
  FeatureOptions options;
  // 16 px away.
  EXPECT_TRUE(FindJunctions({Piece(0, 100, 84, 100), Piece(100, 100, 100, 200)}, options).empty());
  // 8 px away is more than 35 % of a 20 px segment.
  EXPECT_TRUE(FindJunctions({Piece(0, 100, 92, 100), Piece(100, 108, 100, 128)}, options).empty());
  // 10 degrees.
  const double t = std::tan(10.0 * M_PI / 180.0);
  EXPECT_TRUE(FindJunctions({Piece(0, 100, 100, 100), Piece(100, 100, 200, 100 + 100 * t)}, options)
                  .empty());
  EXPECT_TRUE(FindJunctions({}, options).empty());
  EXPECT_TRUE(FindJunctions({Piece(0, 0, 50, 0)}, options).empty());
}

TEST(FindJunctions, MovesWithTheSegmentsUnderRotation) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(0.0, 400.0);
  std::vector<Segment> segments;
  for (int i = 0; i < 120; ++i) {
    const double x = u(rng), y = u(rng), a = u(rng), l = 20 + 0.1 * u(rng);
    segments.push_back(Piece(x, y, x + l * std::cos(a), y + l * std::sin(a)));
  }
  const std::vector<Junction> before = FindJunctions(segments, FeatureOptions());
  ASSERT_GT(before.size(), 5u);
  const double c = std::cos(0.7), s = std::sin(0.7);
  const auto turn = [&](const Eigen::Vector2d& p) {
    return Eigen::Vector2d(c * p.x() - s * p.y() + 500, s * p.x() + c * p.y() + 40);
  };
  for (Segment& segment : segments) {
    segment.start = turn(segment.start);
    segment.end = turn(segment.end);
  }
  const std::vector<Junction> after = FindJunctions(segments, FeatureOptions());
  ASSERT_EQ(after.size(), before.size());
  for (const Junction& junction : before) {
    double best = 1e9;
    for (const Junction& other : after) {
      best = std::min(best, (other.point - turn(junction.point)).norm());
    }
    EXPECT_LT(best, 1e-6);
  }
}

TEST(TypeOf, NamesWhatTheRaysShow) {
  const auto type = [](const std::vector<Segment>& segments) {
    const std::vector<Junction> junctions = FindJunctions(segments, FeatureOptions());
    EXPECT_EQ(junctions.size(), 1u);
    return junctions.empty() ? JunctionType::kMulti : junctions[0].type;
  };
  const Segment west = Piece(20, 100, 99, 100), north = Piece(100, 20, 100, 99),
                east = Piece(101, 100, 180, 100), south = Piece(100, 101, 100, 180),
                north_east = Piece(101, 99, 160, 40), south_east = Piece(101, 101, 160, 160),
                passing = Piece(0, 100, 200, 100);
  EXPECT_EQ(type({west, north}), JunctionType::kL);
  EXPECT_EQ(type({passing, north}), JunctionType::kT);
  EXPECT_EQ(type({west, east, north}), JunctionType::kT);  // cut where the third meets it
  EXPECT_EQ(type({north, north_east, east}), JunctionType::kArrow);
  EXPECT_EQ(type({west, north_east, south_east}), JunctionType::kY);
  EXPECT_EQ(type({west, east, north, south}), JunctionType::kX);
  EXPECT_EQ(type({west, north, north_east, east}), JunctionType::kMulti);
}

}  // namespace
}  // namespace horopter
