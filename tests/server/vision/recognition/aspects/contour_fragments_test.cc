#include "server/vision/recognition/aspects/contour_fragments.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace horopter {
namespace {

using Points = std::array<Eigen::Vector2f, kFragmentPoints>;

Points RandomPiece(std::mt19937* random) {
  std::normal_distribution<float> turn(0.1f, 0.5f);
  Points points;
  float angle = 0.0f;
  points[0] = {0.0f, 0.0f};
  for (int i = 1; i < kFragmentPoints; ++i) {
    points[i] = points[i - 1] + 5.0f * Eigen::Vector2f(std::cos(angle), std::sin(angle));
    angle += turn(*random);
  }
  return points;
}

FragmentOptions AnyPiece() {
  FragmentOptions options;
  options.min_bend_rad = 0.0;
  options.min_chord_share = 0.0;
  return options;
}

TEST(ContourFragments, KeyIsInvariantUnderSimilarities) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> uniform(-3.0f, 3.0f);
  for (int trial = 0; trial < 200; ++trial) {
    const Points points = RandomPiece(&random);
    const auto fragment = MakeFragment(points, AnyPiece());
    ASSERT_TRUE(fragment.has_value());
    const float scale = std::exp(uniform(random)), turn = uniform(random);
    const Eigen::Matrix2f R = Eigen::Rotation2Df(turn).toRotationMatrix();
    const Eigen::Vector2f t(10 * uniform(random), 10 * uniform(random));
    Points moved;
    for (int i = 0; i < kFragmentPoints; ++i) moved[i] = scale * (R * points[i]) + t;
    const auto other = MakeFragment(moved, AnyPiece());
    ASSERT_TRUE(other.has_value());
    EXPECT_LT(SquaredDistance(fragment->key, other->key), 1e-5f);
    EXPECT_NEAR(other->spread / fragment->spread, scale, 1e-3f * scale);
    EXPECT_NEAR(std::remainder(other->chord_rad - fragment->chord_rad - turn, 2 * M_PI), 0.0, 1e-3);
    EXPECT_LT((other->center - (scale * (R * fragment->center) + t)).norm(), 1e-2f * scale + 1e-3f);
  }
}

TEST(ContourFragments, WalkedFromTheOtherEndIsReversed) {
  std::mt19937 random(2);
  for (int trial = 0; trial < 200; ++trial) {
    Points points = RandomPiece(&random);
    const auto forward = MakeFragment(points, AnyPiece());
    std::reverse(points.begin(), points.end());
    const auto backward = MakeFragment(points, AnyPiece());
    ASSERT_TRUE(forward.has_value() && backward.has_value());
    // A mean turn next to half a turn may be counted from either side.
    float mean = 0.0f;
    for (const float a : forward->key) mean += a / kFragmentAngles;
    if (std::abs(std::abs(mean) - M_PI) < 0.01) continue;
    const ContourFragment reversed = Reversed(*forward);
    EXPECT_LT(SquaredDistance(reversed.key, backward->key), 1e-5f);
    EXPECT_NEAR(std::remainder(reversed.chord_rad - backward->chord_rad, 2 * M_PI), 0.0, 1e-3);
  }
}

TEST(ContourFragments, MirrorImageNegatesTheKeyAndDoesNotMatch) {
  // A hook: one sharp corner, one gentle bend, all to the left.
  Points points;
  const float angles[] = {0.0f, 0.0f, 1.2f, 1.2f, 1.3f, 1.4f, 1.5f, 1.6f};
  points[0] = {0.0f, 0.0f};
  for (int i = 0; i < kFragmentAngles; ++i) {
    points[i + 1] = points[i] + Eigen::Vector2f(std::cos(angles[i]), std::sin(angles[i]));
  }
  const auto fragment = MakeFragment(points, {});
  for (Eigen::Vector2f& p : points) p.x() = -p.x();
  const auto mirrored = MakeFragment(points, {});
  ASSERT_TRUE(fragment.has_value() && mirrored.has_value());
  FragmentKey negated = fragment->key;
  for (float& a : negated) a = -a;
  EXPECT_LT(SquaredDistance(negated, mirrored->key), 1e-6f);
  const float gate = 8 * 0.18f * 0.18f;
  EXPECT_GT(SquaredDistance(fragment->key, mirrored->key), gate);
  EXPECT_GT(SquaredDistance(fragment->key, Reversed(*mirrored).key), gate);
}

TEST(ContourFragments, StraightPiecesSayNothing) {
  Points points;
  for (int i = 0; i < kFragmentPoints; ++i) points[i] = {3.0f * i, 0.02f * (i % 2)};
  EXPECT_FALSE(MakeFragment(points, {}).has_value());
}

TEST(ContourFragments, PackedKeysComeBackToHalfAStep) {
  std::mt19937 random(3);
  const auto fragment = MakeFragment(RandomPiece(&random), AnyPiece());
  const FragmentKey back = UnpackKey(PackKey(fragment->key));
  for (int i = 0; i < kFragmentAngles; ++i) {
    EXPECT_NEAR(back[i], fragment->key[i], 0.51f / kKeyScale);
  }
}

// The outline of a square, with a gap in the middle of one side.
ContourGraph SquareWithGap(int side, int gap) {
  std::vector<Eigen::Vector2f> points;
  for (int i = 0; i < side; ++i) {
    if (std::abs(i - side / 2) >= gap / 2 + 1) points.emplace_back(10.0f + i, 10.0f);
    points.emplace_back(10.0f + side, 10.0f + i);
    points.emplace_back(10.0f + side - i, 10.0f + side);
    points.emplace_back(10.0f, 10.0f + side - i);
  }
  return TraceContours(MakePointRaster(side + 20, side + 20, points), 6.0);
}

TEST(ContourFragments, ContoursRunThroughCornersAndSmallGaps) {
  FragmentOptions options;
  options.min_length = 150.0;  // three sides of 60 and less than the fourth
  options.max_length = 150.0;
  EXPECT_FALSE(CollectFragments(SquareWithGap(60, 4), options).empty());
  // All pieces over the gap are still squares' pieces: right angles only.
  for (const ContourFragment& f : CollectFragments(SquareWithGap(60, 4), options)) {
    EXPECT_GT(f.turning, 1.4);
    EXPECT_LT(f.turning, 5.5);
  }
  const ContourGraph wide = SquareWithGap(60, 14);
  for (const ContourChain& chain : wide.chains) {
    for (const auto* links : {&chain.after_front, &chain.after_back}) {
      for (const ChainLink& link : *links) EXPECT_LE(link.gap_px, 6.0f);
    }
  }
}

TEST(ContourFragments, PiecesThatComeAgainInManyPlacesAreDropped) {
  ContourFragment piece;
  piece.key = {0.4f, 0.3f, 0.2f, 0.1f, -0.1f, -0.2f, -0.3f, -0.4f};
  piece.spread = 10.0f;
  piece.chord_rad = 0.1f;
  std::vector<ContourFragment> fragments;
  for (int k = 0; k < 9; ++k) {
    piece.center = {50.0f * static_cast<float>(k), 100.0f};
    fragments.push_back(piece);
  }
  ContourFragment turned = piece, larger = piece;
  turned.chord_rad += 1.0f;
  larger.spread *= 2.0f;
  fragments.push_back(turned);
  fragments.push_back(larger);
  std::vector<ContourFragment> few = fragments;
  DropRepeated(9, &few);
  EXPECT_EQ(few.size(), 11u);
  DropRepeated(8, &fragments);
  ASSERT_EQ(fragments.size(), 2u);
  EXPECT_EQ(fragments[0].chord_rad, turned.chord_rad);
  EXPECT_EQ(fragments[1].spread, larger.spread);
  // The same place many times is one: lengths and starts of one contour.
  std::vector<ContourFragment> here(20, piece);
  DropRepeated(1, &here);
  EXPECT_EQ(here.size(), 20u);
}

TEST(ContourFragments, NothingComesOfNothing) {
  FragmentOptions options;
  options.min_length = 20.0;
  options.max_length = 100.0;
  EXPECT_TRUE(CollectFragments({}, options).empty());
  EXPECT_TRUE(TraceContours(MakePointRaster(10, 10, {}), 6.0).chains.empty());
}

}  // namespace
}  // namespace horopter
