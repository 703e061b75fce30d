#include "server/vision/recognition/aspects/pattern_edges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/support/random.h"

namespace horopter {
namespace {

constexpr int kWidth = 640, kHeight = 480;

// Edge points of drawings, and which of them belong to the pattern.
struct Drawing {
  std::vector<Eigen::Vector2f> points;
  std::vector<bool> pattern;

  void Line(Eigen::Vector2f from, Eigen::Vector2f to, bool is_pattern) {
    const int n = static_cast<int>((to - from).norm());
    for (int i = 0; i <= n; ++i) Add(from + (to - from) * (static_cast<float>(i) / n), is_pattern);
  }
  void Circle(Eigen::Vector2f center, float radius, bool is_pattern, float share = 1.0f) {
    const int n = static_cast<int>(6.3f * radius);
    for (int i = 0; i < share * static_cast<float>(n); ++i) {
      const float a = 6.2831853f * static_cast<float>(i) / static_cast<float>(n);
      Add(center + radius * Eigen::Vector2f(std::cos(a), std::sin(a)), is_pattern);
    }
  }
  void Add(const Eigen::Vector2f& p, bool is_pattern) {
    if (p.x() < 0 || p.y() < 0 || p.x() > kWidth - 1 || p.y() > kHeight - 1) return;
    points.push_back(p);
    pattern.push_back(is_pattern);
  }
};

// Share of the pattern's points that are found, and of the others that are taken for pattern.
struct Shares {
  double found = 0.0, taken = 0.0;
};

Shares Ask(const Drawing& drawing, const std::vector<Eigen::Vector2f>& texture = {}) {
  const PointRaster raster = MakePointRaster(kWidth, kHeight, drawing.points);
  const std::vector<std::uint8_t> marked =
      FindPatternPoints(raster, TraceContours(raster, 6.0), texture);
  if (marked.empty()) return {};
  EXPECT_EQ(marked.size(), raster.points.size());
  double found = 0, of_pattern = 0, taken = 0, others = 0;
  for (std::size_t i = 0; i < drawing.points.size(); ++i) {
    const Eigen::Vector2f& p = drawing.points[i];
    const int x = static_cast<int>(p.x() + 0.5f), y = static_cast<int>(p.y() + 0.5f);
    const std::int32_t e = raster.at[static_cast<std::size_t>(y) * kWidth + x];
    if (e < 0) continue;
    (drawing.pattern[i] ? of_pattern : others) += 1;
    (drawing.pattern[i] ? found : taken) += marked[e];
  }
  return {of_pattern > 0 ? found / of_pattern : 0.0, others > 0 ? taken / others : 0.0};
}

// Lines through one point far above the image: a striped table seen obliquely.
void AddStripes(Drawing* drawing) {
  for (int k = -30; k <= 60; ++k) {
    const Eigen::Vector2f foot(static_cast<float>(24 * k), kHeight - 1.0f);
    const Eigen::Vector2f far(300.0f, -600.0f);
    const float top = (0.0f - foot.y()) / (far.y() - foot.y());
    drawing->Line(foot, foot + top * (far - foot), true);
  }
}

TEST(PatternEdges, StripesAreFoundAndAContourBeforeThemIsNot) {
  Drawing drawing;
  AddStripes(&drawing);
  drawing.Circle({320, 240}, 90, false);
  const Shares shares = Ask(drawing);
  EXPECT_GT(shares.found, 0.9);
  EXPECT_LT(shares.taken, 0.35);  // crossings are both
}

TEST(PatternEdges, RibsOfAPartAreNoStripes) {
  Drawing drawing;
  for (int k = 0; k < 30; ++k) {
    const float x = 250.0f + 6.0f * static_cast<float>(k);
    drawing.Line({x, 180}, {x, 320}, false);
  }
  EXPECT_EQ(Ask(drawing).taken, 0.0);
}

// A square grid on a plane that recedes: far cells are shorter than what makes a family. Contours
// break at the crossings.
void AddGrid(Drawing* drawing) {
  const auto at = [](float x, float y) {
    const float depth = 0.33f + 0.07f * y;
    return Eigen::Vector2f(320.0f + 20.0f * x / depth, -10.0f + 160.0f / depth);
  };
  constexpr float kGap = 0.06f;
  for (int x = -15; x <= 15; ++x) {
    for (int y = 0; y < 8; ++y) {
      const float fx = static_cast<float>(x), fy = static_cast<float>(y);
      drawing->Line(at(fx + kGap, fy), at(fx + 1 - kGap, fy), true);
      drawing->Line(at(fx, fy + kGap), at(fx, fy + 1 - kGap), true);
    }
  }
}

TEST(PatternEdges, AGridIsFoundWithItsFarCells) {
  Drawing drawing;
  AddGrid(&drawing);
  drawing.Circle({330.0f, 250.0f}, 90.0f, false);
  const Shares shares = Ask(drawing);
  EXPECT_GT(shares.found, 0.8);
  EXPECT_LT(shares.taken, 0.2);
}

TEST(PatternEdges, RibsOfAPartBeforeAGridHideItNot) {
  Drawing drawing;
  AddGrid(&drawing);
  for (int i = 0; i < 40; ++i) {
    const float x = 200.0f + 5.0f * static_cast<float>(i);
    drawing.Line({x, 150.0f}, {x + 60.0f, 340.0f}, false);
  }
  const Shares shares = Ask(drawing);
  EXPECT_GT(shares.found, 0.6);  // ribs break cells
  EXPECT_LT(shares.taken, 0.2);
}

TEST(PatternEdges, HolesOfAPerforatedSheetAreFoundAndALargeContourIsNot) {
  Drawing drawing;
  for (int y = 20; y < kHeight; y += 40) {
    for (int x = 20; x < kWidth; x += 40) {
      const Eigen::Vector2f center(static_cast<float>(x), static_cast<float>(y));
      if ((center - Eigen::Vector2f(320, 240)).norm() > 125) drawing.Circle(center, 9, true);
    }
  }
  drawing.Circle({320, 240}, 100, false);
  const Shares shares = Ask(drawing);
  EXPECT_GT(shares.found, 0.9);
  EXPECT_LT(shares.taken, 0.05);
}

TEST(PatternEdges, HolesWithBrokenRimsAreFoundWhereTheirLatticeGoesOn) {
  Drawing drawing;
  for (int row = 0; row < 12; ++row) {
    for (int column = 0; column < 16; ++column) {
      const Eigen::Vector2f center(20.0f + 40.0f * static_cast<float>(column),
                                   20.0f + 40.0f * static_cast<float>(row));
      if ((center - Eigen::Vector2f(320, 240)).norm() < 115) continue;
      const bool broken = (row + 3 * column) % 5 == 0 || column == 15;
      drawing.Circle(center, 9, true, broken ? 0.6f : 1.0f);
    }
  }
  // A part's contour, and a hole and a slot of its own between where the sheet's would be.
  drawing.Circle({320, 240}, 90, false);
  drawing.Circle({320, 220}, 8, false, 0.6f);
  drawing.Line({300, 258}, {352, 258}, false);
  const Shares shares = Ask(drawing);
  EXPECT_GT(shares.found, 0.9);
  EXPECT_LT(shares.taken, 0.05);
}

// Edges dropped as texture above a height of the image.
std::vector<Eigen::Vector2f> TextureAbove(int height) {
  std::vector<Eigen::Vector2f> out;
  for (int y = 0; y < height; y += 4) {
    for (int x = 0; x < kWidth; x += 4)
      out.emplace_back(static_cast<float>(x), static_cast<float>(y));
  }
  return out;
}

TEST(PatternEdges, ASheetWhoseFarEndIsTextureIsFoundByItsNearHoles) {
  Drawing drawing;
  for (int y = 340; y < kHeight; y += 40) {
    for (int x = 20; x < kWidth; x += 40)
      drawing.Circle({static_cast<float>(x), static_cast<float>(y)}, 9, true);
  }
  EXPECT_EQ(Ask(drawing).found, 0.0);
  EXPECT_GT(Ask(drawing, TextureAbove(320)).found, 0.9);
  Drawing few;
  for (int k = 0; k < 12; ++k)
    few.Circle({60.0f + 45.0f * static_cast<float>(k), 400.0f}, 9, false);
  EXPECT_EQ(Ask(few, TextureAbove(320)).taken, 0.0);
}

TEST(PatternEdges, AFewHolesAreAPartsOwn) {
  Drawing drawing;
  for (int k = 0; k < 12; ++k)
    drawing.Circle({60.0f + 45.0f * static_cast<float>(k), 200.0f}, 9, false);
  EXPECT_EQ(Ask(drawing).taken, 0.0);
}

TEST(PatternEdges, SmallHolesArePatternInALatticeAndSpecksAreNot) {
  Drawing sheet, specks;
  Random random(1);
  for (int y = 10; y < kHeight; y += 16) {
    for (int x = 10; x < kWidth; x += 16) {
      const Eigen::Vector2f center(static_cast<float>(x), static_cast<float>(y));
      if ((center - Eigen::Vector2f(320, 240)).norm() > 105) sheet.Circle(center, 2.6f, true);
      specks.Circle({static_cast<float>(random.Uniform(0, kWidth)),
                     static_cast<float>(random.Uniform(0, kHeight))},
                    2.6f,
                    false);
    }
  }
  sheet.Circle({320, 240}, 100, false);
  const Shares shares = Ask(sheet);
  EXPECT_GT(shares.found, 0.9);
  EXPECT_LT(shares.taken, 0.05);
  EXPECT_EQ(Ask(specks).taken, 0.0);
}

TEST(PatternEdges, NothingOfAnEmptyImage) {
  EXPECT_TRUE(FindPatternPoints(MakePointRaster(kWidth, kHeight, {}), {}).empty());
}

}  // namespace
}  // namespace horopter
