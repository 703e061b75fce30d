#include "server/vision/features/chain_splitting.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/server/vision/features/synthetic_chains.h"

namespace horopter {
namespace {

constexpr ChainSplittingMethod kMethods[] = {ChainSplittingMethod::kSplitAndMerge,
                                             ChainSplittingMethod::kCurvatureThreshold,
                                             ChainSplittingMethod::kCurvatureTemplates};

ChainSplittingOptions With(ChainSplittingMethod method) {
  ChainSplittingOptions options;
  options.method = method;
  return options;
}

std::vector<ChainPiece> Split(const std::vector<Eigen::Vector2f>& points,
                              const ChainSplittingOptions& options,
                              bool closed = false) {
  const auto pieces = SplitChain(points, closed, options);
  EXPECT_TRUE(pieces.ok()) << pieces.status();
  return pieces.value_or(std::vector<ChainPiece>());
}

std::vector<int> Cuts(const std::vector<ChainPiece>& pieces) {
  std::vector<int> cuts;
  for (size_t k = 1; k < pieces.size(); ++k) cuts.push_back(pieces[k].begin);
  return cuts;
}

bool Near(const std::vector<int>& cuts, int at, int within) {
  return std::any_of(
      cuts.begin(), cuts.end(), [&](int cut) { return std::abs(cut - at) <= within; });
}

TEST(TemplateCorrelation, OfATemplateWithItselfIsOneWhateverItsHeightAndBase) {
  for (const CurvatureTemplate& shape : TemplateSplittingOptions().templates) {
    std::vector<double> signal(61, 0.0);
    const int start = 30 - shape.before - shape.middle / 2;
    for (int i = 0; i < 61; ++i) {
      const double s = std::clamp((i - start - shape.before + 0.5) / shape.middle, 0.0, 1.0);
      signal[i] = shape.shape == TemplateShape::kPeak     ? 1.0 - std::abs(2.0 * s - 1.0)
                  : shape.shape == TemplateShape::kStepUp ? s
                                                          : 1.0 - s;
    }
    for (double height : {0.02, 1.0, -0.3}) {
      std::vector<double> scaled;
      for (double v : signal) scaled.push_back(0.05 + height * v);
      const auto correlation = TemplateCorrelation(scaled, false, shape, 0.0);
      EXPECT_NEAR(correlation[30], std::copysign(1.0, height), 1e-9);
      for (double c : correlation) EXPECT_LE(std::abs(c), 1.0 + 1e-9);
      // The floor takes more from low shapes than from high ones.
      const double floored = TemplateCorrelation(scaled, false, shape, 0.02)[30];
      EXPECT_LT(std::abs(floored), 1.0);
      EXPECT_GT(std::abs(TemplateCorrelation(scaled, false, shape, 0.002)[30]), std::abs(floored));
    }
  }
}

TEST(TemplateCorrelation, ConstantCurvatureHasNoShape) {
  const std::vector<double> constant(50, 0.123456789);
  for (const CurvatureTemplate& shape : TemplateSplittingOptions().templates) {
    for (double c : TemplateCorrelation(constant, true, shape, 0.0)) EXPECT_EQ(c, 0.0);
    EXPECT_TRUE(TemplateCorrelation({}, true, shape, 0.0).empty());
  }
}

TEST(SuppressNonMaxima, KeepsTheLargestOfEachNeighbourhoodAroundTheSeamToo) {
  const std::vector<double> values = {0.8, 0.1, 0.1, 0.6, 0.7, 0.1, 0.1, 0.1, 0.1, 0.9};
  EXPECT_EQ(SuppressNonMaxima(values, {}, false, 0.5, 2), (std::vector<int>{0, 4, 9}));
  EXPECT_EQ(SuppressNonMaxima(values, {}, true, 0.5, 2), (std::vector<int>{4, 9}));
  EXPECT_EQ(SuppressNonMaxima(values, {}, true, 0.5, 1000), (std::vector<int>{9}));
  const std::vector<int> reach = {0, 0, 0, 5, 5, 0, 0, 0, 0, 0};
  EXPECT_EQ(SuppressNonMaxima(values, reach, false, 0.5, 2), (std::vector<int>{0, 9}));
}

class SplittingNoise : public testing::TestWithParam<double> {};

// Lines, corners of 25 to 120 degrees, joins of lines with arcs: the templates find them all.
TEST_P(SplittingNoise, TemplatesFindCornersAndSmoothJoinsAndSayWhatIsCurved) {
  const unsigned seed = 21;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  int corners = 0, corners_found = 0, smooth = 0, smooth_found = 0, cuts_made = 0, kinds = 0,
      kinds_right = 0;
  for (int trial = 0; trial < 60; ++trial) {
    ChainWalk walk({100, 100}, 2 * M_PI * u(rng));
    const double side = trial % 2 == 0 ? 1.0 : -1.0;
    walk.Line(30 + 30 * u(rng))
        .Turn(side * (25 + 95 * u(rng)) * M_PI / 180)
        .Line(30 + 30 * u(rng))
        .Arc(12 + 13 * u(rng), side * (1.5 + u(rng)))
        .Line(30 + 30 * u(rng));
    const SyntheticChain& chain = walk.chain();
    const auto pieces =
        Split(chain.Noisy(GetParam(), &rng), With(ChainSplittingMethod::kCurvatureTemplates));
    const std::vector<int> cuts = Cuts(pieces);
    cuts_made += static_cast<int>(cuts.size());
    ++corners;
    corners_found += Near(cuts, chain.joins[0], 2);
    smooth += 2;
    smooth_found += Near(cuts, chain.joins[1], 5) + Near(cuts, chain.joins[2], 5);
    for (const ChainPiece& piece : pieces) {
      ++kinds;
      kinds_right += piece.curved == (chain.curvature[(piece.begin + piece.end) / 2] != 0.0);
    }
  }
  std::printf("noise %.2f: corners %.3f, smooth joins %.3f, cuts per join %.3f, kinds %.3f\n",
              GetParam(),
              1.0 * corners_found / corners,
              1.0 * smooth_found / smooth,
              1.0 * cuts_made / (corners + smooth),
              1.0 * kinds_right / kinds);
  EXPECT_GE(1.0 * corners_found / corners, 0.95);
  EXPECT_GE(1.0 * smooth_found / smooth, 0.9);
  EXPECT_LE(1.0 * cuts_made / (corners + smooth), 1.1);
  EXPECT_GE(1.0 * kinds_right / kinds, 0.95);
}

INSTANTIATE_TEST_SUITE_P(Px, SplittingNoise, testing::Values(0.0, 0.05, 0.1, 0.15));

// Thesis figure 2.5: no threshold on curvature cuts the obtuse corner and spares the small circle.
TEST(SplitChain, TemplatesCutAnObtuseCornerAndSpareASmallCircleAsNoThresholdCan) {
  std::mt19937 rng(22);
  const auto corner =
      ChainWalk({50, 50}, 0.4).Line(50).Turn(25 * M_PI / 180).Line(50).chain().Noisy(0.03, &rng);
  const auto circle = ChainWalk({50, 50}, 0.0).Arc(10, 2 * M_PI).chain().Noisy(0.03, &rng);
  const auto templates = With(ChainSplittingMethod::kCurvatureTemplates);
  EXPECT_TRUE(Near(Cuts(Split(corner, templates)), 50, 2));
  const auto pieces = Split(circle, templates, true);
  ASSERT_EQ(pieces.size(), 1u);
  EXPECT_TRUE(pieces[0].curved);
  auto threshold = With(ChainSplittingMethod::kCurvatureThreshold);
  threshold.rejoin_factor = 0.0;
  for (threshold.max_curvature = 0.01; threshold.max_curvature < 0.2;
       threshold.max_curvature *= 1.1) {
    const bool cuts_corner = Near(Cuts(Split(corner, threshold)), 50, 2);
    const bool spares_circle = Split(circle, threshold, true).size() == 1;
    EXPECT_FALSE(cuts_corner && spares_circle) << threshold.max_curvature;
  }
}

TEST(SplitChain, OneLineIsOneStraightPieceWithEveryMethod) {
  for (double noise : {0.0, 0.1, 0.2}) {
    std::mt19937 rng(23);
    for (int trial = 0; trial < 20; ++trial) {
      const auto points =
          ChainWalk({50, 50}, 0.3 * trial).Line(60 + 10 * trial).chain().Noisy(noise, &rng);
      for (ChainSplittingMethod method : kMethods) {
        const auto pieces = Split(points, With(method));
        ASSERT_EQ(pieces.size(), 1u) << noise << " " << trial;
        EXPECT_EQ(pieces[0].begin, 0);
        EXPECT_EQ(pieces[0].end, static_cast<int>(points.size()));
        EXPECT_FALSE(pieces[0].curved);
      }
    }
  }
}

TEST(SplitChain, PiecesAreInOrderShareTheirEndsAndAreLongEnough) {
  std::mt19937 rng(24);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  for (int trial = 0; trial < 100; ++trial) {
    ChainWalk walk({0, 0}, 3 * u(rng));
    for (int k = 0; k < 8; ++k) {
      walk.Line(3 + 15 * std::abs(u(rng))).Turn(2 * u(rng)).Arc(5 + 20 * std::abs(u(rng)), u(rng));
    }
    const auto points = walk.chain().Noisy(0.4 * std::abs(u(rng)), &rng);
    for (ChainSplittingMethod method : kMethods) {
      for (double rejoin : {0.0, 1.3}) {
        auto options = With(method);
        options.rejoin_factor = rejoin;
        int end = 1;
        for (const ChainPiece& piece : Split(points, options, trial % 2 == 0)) {
          EXPECT_GE(piece.begin, end - 1);
          EXPECT_GE(piece.end - piece.begin, 6);
          end = piece.end;
        }
        EXPECT_LE(end, static_cast<int>(points.size()));
      }
    }
  }
}

TEST(SplitChain, SplitAndMergeIsWhatItIsByItself) {
  std::mt19937 rng(25);
  const auto points =
      ChainWalk({0, 0}, 0.1).Line(40).Turn(1).Line(20).Arc(20, 2).chain().Noisy(0.1, &rng);
  const auto pieces = Split(points, ChainSplittingOptions()), alone = SplitAndMerge(points, {});
  ASSERT_EQ(pieces.size(), alone.size());
  for (size_t k = 0; k < pieces.size(); ++k) {
    EXPECT_EQ(pieces[k].begin, alone[k].begin);
    EXPECT_EQ(pieces[k].end, alone[k].end);
  }
}

TEST(SplitChain, AwkwardChainsGiveNoPiecesOrSomeButDoNotFail) {
  std::mt19937 rng(26);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  for (ChainSplittingMethod method : kMethods) {
    for (int n : {0, 1, 2, 3, 5, 6, 7, 50, 3000}) {
      std::vector<Eigen::Vector2f> random, zigzag, huge;
      for (int i = 0; i < n; ++i) {
        random.emplace_back(50 * u(rng), 50 * u(rng));
        zigzag.emplace_back(i, i % 2);
        huge.emplace_back(1e18f * u(rng), 1e18f * u(rng));
      }
      const std::vector<Eigen::Vector2f> same(n, Eigen::Vector2f(3, 4));
      for (const auto& points : {random, zigzag, same, huge}) {
        if (&points == &random && n == 3000) continue;
        EXPECT_TRUE(SplitChain(points, false, With(method)).ok());
        EXPECT_TRUE(SplitChain(points, true, With(method)).ok());
      }
    }
  }
}

TEST(SplitChain, RefusesBadOptionsAndPointsThatAreNotFinite) {
  std::vector<Eigen::Vector2f> points(20, Eigen::Vector2f(1, 1));
  const auto code = [&](const ChainSplittingOptions& options) {
    return SplitChain(points, false, options).status().code();
  };
  constexpr auto kBad = absl::StatusCode::kInvalidArgument;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  ChainSplittingOptions o;
  o.templates.templates.clear();
  EXPECT_EQ(code(o), kBad);
  o = {};
  o.templates.templates[0].middle = 0;
  EXPECT_EQ(code(o), kBad);
  o = {};
  o.templates.threshold = nan;
  EXPECT_EQ(code(o), kBad);
  o = {};
  o.max_curvature = nan;
  EXPECT_EQ(code(o), kBad);
  o = {};
  o.rejoin_factor = -1.0;
  EXPECT_EQ(code(o), kBad);
  o = {};
  o.curvature.half_width = 0;
  EXPECT_EQ(code(o), kBad);
  points[3].y() = std::numeric_limits<float>::infinity();
  for (ChainSplittingMethod method : kMethods) EXPECT_EQ(code(With(method)), kBad);
}

TEST(IsCurved, TellsAnArcFromALineAndACircleFromBoth) {
  std::mt19937 rng(27);
  for (double noise : {0.0, 0.1, 0.3}) {
    EXPECT_FALSE(IsCurved(ChainWalk({5, 5}, 1).Line(100).chain().Noisy(noise, &rng), 0.7));
    EXPECT_TRUE(IsCurved(ChainWalk({5, 5}, 1).Arc(100, 0.6).chain().Noisy(noise, &rng), 0.7));
    EXPECT_TRUE(IsCurved(ChainWalk({5, 5}, 1).Arc(20, 6.28).chain().Noisy(noise, &rng), 0.7));
  }
  EXPECT_FALSE(IsCurved({}, 0.7));
}

}  // namespace
}  // namespace horopter
