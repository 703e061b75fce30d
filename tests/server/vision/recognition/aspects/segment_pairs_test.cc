#include "server/vision/recognition/aspects/segment_pairs.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <vector>

namespace horopter {
namespace {

constexpr int kWidth = 400, kHeight = 300;

using Polygon = std::vector<Eigen::Vector2f>;

// Edge points of closed polygons, a pixel apart, with noise across.
ContourGraph Contours(const std::vector<Polygon>& polygons,
                      float sigma_px = 0.0f,
                      unsigned seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<float> noise(0.0f, 1.0f);
  std::vector<Eigen::Vector2f> points;
  for (const Polygon& p : polygons) {
    for (std::size_t i = 0; i < p.size(); ++i) {
      const Eigen::Vector2f along = p[(i + 1) % p.size()] - p[i];
      const Eigen::Vector2f across = Eigen::Vector2f(-along.y(), along.x()).normalized();
      const int n = static_cast<int>(along.norm());
      for (int k = 0; k < n; ++k) {
        points.push_back(p[i] + along * (static_cast<float>(k) / static_cast<float>(n)) +
                         sigma_px * noise(random) * across);
      }
    }
  }
  return TraceContours(MakePointRaster(kWidth, kHeight, points), 6.0);
}

// A right-angled triangle with legs of 90 and 60 px.
Polygon Triangle(float turn_rad, float scale = 1.0f) {
  const Eigen::Matrix2f R = Eigen::Rotation2Df(turn_rad).toRotationMatrix();
  const Eigen::Vector2f corner(200.0f, 150.0f);
  return {corner,
          corner + scale * (R * Eigen::Vector2f(90.0f, 0.0f)),
          corner + scale * (R * Eigen::Vector2f(0.0f, 60.0f))};
}

const SegmentPair* At(const std::vector<SegmentPair>& pairs, const Eigen::Vector2f& corner) {
  for (const SegmentPair& p : pairs) {
    if ((p.corner - corner).norm() < 3.0f) return &p;
  }
  return nullptr;
}

TEST(SegmentPairs, CornersOfATriangleAtAllTurnsAndUnderNoise) {
  for (int turn = 0; turn < 12; ++turn) {
    for (const float sigma_px : {0.0f, 0.1f, 0.2f}) {
      const auto angle = static_cast<float>(turn * M_PI / 6.0 + 0.1);
      SCOPED_TRACE(testing::Message()
                   << "turn " << turn << " noise " << sigma_px << " seed " << turn);
      const Polygon triangle = Triangle(angle);
      SegmentPairOptions options;
      options.max_offset = 1.2 + 2.0 * sigma_px;
      const auto pairs = CollectSegmentPairs(Contours({triangle}, sigma_px, turn), options);
      ASSERT_EQ(pairs.size(), 3u);
      const SegmentPair* right = At(pairs, triangle[0]);
      ASSERT_NE(right, nullptr);
      EXPECT_NEAR(right->opening_rad, M_PI / 2, 0.05);
      EXPECT_NEAR(std::remainder(right->direction_rad - angle, 2 * M_PI), 0.0, 0.05);
      EXPECT_NEAR(right->length_a, 90.0f, 6.0f);
      EXPECT_NEAR(right->length_b, 60.0f, 6.0f);
      EXPECT_NE(At(pairs, triangle[1]), nullptr);
      EXPECT_NE(At(pairs, triangle[2]), nullptr);
    }
  }
}

TEST(SegmentPairs, MirrorImageSwapsTheArms) {
  Polygon mirrored = Triangle(0.3f);
  for (Eigen::Vector2f& p : mirrored) p.x() = kWidth - p.x();
  const auto pairs = CollectSegmentPairs(Contours({mirrored}));
  const SegmentPair* right = At(pairs, mirrored[0]);
  ASSERT_NE(right, nullptr);
  EXPECT_NEAR(right->length_a, 60.0f, 4.0f);
  EXPECT_NEAR(right->length_b, 90.0f, 4.0f);
}

TEST(SegmentPairs, AnArmGoesOnOverAGap) {
  Polygon triangle = Triangle(0.2f);
  ContourGraph graph = Contours({triangle});
  // Points of the long leg about its middle are missing.
  const Eigen::Vector2f middle = 0.5f * (triangle[0] + triangle[1]);
  std::vector<Eigen::Vector2f> left;
  for (const Eigen::Vector2f& p : graph.points) {
    if ((p - middle).norm() > 1.8f) left.push_back(p);
  }
  const auto pairs =
      CollectSegmentPairs(TraceContours(MakePointRaster(kWidth, kHeight, left), 6.0));
  const SegmentPair* right = At(pairs, triangle[0]);
  ASSERT_NE(right, nullptr);
  EXPECT_NEAR(right->length_a, 90.0f, 6.0f);
}

TEST(SegmentPairs, ALineThatEndsOnAnotherMakesAPairToEachSide) {
  const Polygon bar = {{100.0f, 150.0f}, {300.0f, 150.0f}};
  const Polygon stem = {{200.0f, 151.0f}, {200.0f, 230.0f}};
  const auto pairs = CollectSegmentPairs(Contours({bar, stem}));
  ASSERT_EQ(pairs.size(), 2u);
  for (const SegmentPair& p : pairs) {
    EXPECT_NEAR(p.opening_rad, M_PI / 2, 0.05);
    EXPECT_NEAR(std::max(p.length_a, p.length_b), 100.0f, 4.0f);
    EXPECT_NEAR(std::min(p.length_a, p.length_b), 80.0f, 4.0f);
  }
}

TEST(SegmentPairs, StraightOnFarApartShortAndNothingAreNoPairs) {
  EXPECT_TRUE(CollectSegmentPairs({}).empty());
  // In line, and parallel.
  EXPECT_TRUE(CollectSegmentPairs(Contours({{{50.0f, 50.0f}, {120.0f, 52.0f}},
                                            {{130.0f, 52.0f}, {200.0f, 54.0f}},
                                            {{50.0f, 90.0f}, {200.0f, 94.0f}}}))
                  .empty());
  // Lines that would meet 40 px beyond their ends.
  EXPECT_TRUE(CollectSegmentPairs(Contours({{{50.0f, 50.0f}, {100.0f, 50.0f}},
                                            {{140.0f, 90.0f}, {140.0f, 160.0f}}}))
                  .empty());
  EXPECT_TRUE(CollectSegmentPairs(Contours({{{50, 50}, {58, 50}, {50, 58}}})).empty());
}

TEST(SegmentPairs, TheLongestAreKept) {
  const std::vector<Polygon> two = {Triangle(0.4f), {{20, 20}, {50, 20}, {20, 50}}};
  SegmentPairOptions options;
  options.max_pairs = 3;
  const auto pairs = CollectSegmentPairs(Contours(two), options);
  ASSERT_EQ(pairs.size(), 3u);
  for (const Eigen::Vector2f& corner : two[0]) EXPECT_NE(At(pairs, corner), nullptr);
}

}  // namespace
}  // namespace horopter
