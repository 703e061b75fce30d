#include "server/vision/features/segment_merging.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace horopter {
namespace {

FittedSegment Piece(
    double x0, double y0, double x1, double y1, double contrast = 50.0, int channel = 0) {
  FittedSegment piece;
  piece.segment.start = {x0, y0};
  piece.segment.end = {x1, y1};
  piece.segment.contrast = contrast;
  piece.segment.channel = channel;
  const int n = static_cast<int>(piece.segment.Length()) + 1;
  for (int i = 0; i <= n; ++i) {
    const Eigen::Vector2d p =
        piece.segment.start + (piece.segment.end - piece.segment.start) * (1.0 * i / n);
    piece.samples.push_back({p.cast<float>(), 10.0f});
  }
  return piece;
}

// The cases of thesis figure 2.9.
TEST(MergeSegments, JoinsOverlappingAndGappedPieces) {
  const auto overlapping =
      MergeSegments({Piece(0, 50, 60, 50), Piece(40, 50.3, 100, 50.3)}, FeatureOptions());
  ASSERT_EQ(overlapping.size(), 1u);
  EXPECT_NEAR(overlapping[0].Length(), 100.0, 0.5);
  const auto gapped =
      MergeSegments({Piece(0, 50, 60, 50), Piece(69, 50, 130, 50)}, FeatureOptions());
  ASSERT_EQ(gapped.size(), 1u);
  EXPECT_NEAR(gapped[0].Length(), 130.0, 0.5);
  EXPECT_EQ(MergeSegments({Piece(0, 50, 60, 50), Piece(71, 50, 130, 50)}, FeatureOptions()).size(),
            2u);
}

TEST(MergeSegments, KeepsParallelAndTurnedPiecesApart) {
  EXPECT_EQ(MergeSegments({Piece(0, 50, 60, 50), Piece(0, 52, 60, 52)}, FeatureOptions()).size(),
            2u);
  const double t = std::tan(4.0 * M_PI / 180.0);
  EXPECT_EQ(MergeSegments({Piece(0, 50, 60, 50), Piece(61, 50, 121, 50 + 60 * t)}, FeatureOptions())
                .size(),
            2u);
  EXPECT_TRUE(MergeSegments({}, FeatureOptions()).empty());
}

TEST(MergeSegments, DuplicatesOfChannelsKeepTheStrongestChannelAndItsPolarity) {
  // The weaker channel saw the edge with the opposite polarity.
  const auto merged = MergeSegments(
      {Piece(100, 50.1, 0, 50.1, 10.0, 3), Piece(0, 50, 100, 50, 60.0, 1)}, FeatureOptions());
  ASSERT_EQ(merged.size(), 1u);
  EXPECT_EQ(merged[0].channel, 1);
  EXPECT_GT(merged[0].end.x(), merged[0].start.x());
  EXPECT_DOUBLE_EQ(merged[0].contrast, 60.0);
}

TEST(MergeSegments, ManyFragmentsOfRandomLinesBecomeTheLines) {
  std::mt19937 rng(9);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  std::vector<FittedSegment> pieces;
  for (int line = 0; line < 8; ++line) {
    // 40 px apart, so that lines cannot be confused.
    const double y = 20 + 40 * line;
    double x = 10.0;
    while (x < 380) {
      const double length = 15 + 30 * u(rng);
      const double lift = 0.2 * (u(rng) - 0.5);
      pieces.push_back(Piece(x, y + lift, x + length, y + lift));
      x += length + 8.0 * u(rng);
    }
  }
  std::shuffle(pieces.begin(), pieces.end(), rng);
  const auto merged = MergeSegments(std::move(pieces), FeatureOptions());
  ASSERT_EQ(merged.size(), 8u);
  for (const Segment& segment : merged) {
    EXPECT_GT(segment.Length(), 360.0);
    EXPECT_LT(std::abs(std::remainder(segment.start.y() - 20.0, 40.0)), 0.2);
    EXPECT_LT(std::abs(std::remainder(segment.end.y() - 20.0, 40.0)), 0.2);
  }
}

// The same cases by the deviations of the fits instead of fixed tolerances.
TEST(MergeSegments, StatisticalTestFollowsTheDeviations) {
  FeatureOptions options;
  options.merge_test = MergeTest::kStatistical;
  const auto count = [&](FittedSegment a, FittedSegment b, double offset_sigma_px) {
    for (FittedSegment* piece : {&a, &b}) {
      piece->segment.offset_sigma_px = offset_sigma_px;
      piece->segment.angle_sigma_rad = offset_sigma_px / piece->segment.Length();
    }
    return MergeSegments({a, b}, options).size();
  };
  // Overlapping, gapped.
  EXPECT_EQ(count(Piece(0, 50, 60, 50), Piece(40, 50.3, 100, 50.3), 0.05), 1u);
  EXPECT_EQ(count(Piece(0, 50, 60, 50), Piece(69, 50, 130, 50), 0.05), 1u);
  // Side by side: apart when both are sharp, one edge when neither knows better.
  EXPECT_EQ(count(Piece(0, 50, 60, 50), Piece(0, 51.4, 60, 51.4), 0.05), 2u);
  EXPECT_EQ(count(Piece(0, 50, 60, 50), Piece(0, 51.4, 60, 51.4), 0.6), 1u);
  // A turn of 3.4 degrees: much for two long pieces, nothing for a stub.
  EXPECT_EQ(count(Piece(0, 50, 60, 50), Piece(62, 50.1, 122, 53.7), 0.05), 2u);
  EXPECT_EQ(count(Piece(0, 50, 60, 50), Piece(62, 50.1, 72, 50.7), 0.05), 1u);
}

}  // namespace
}  // namespace horopter
