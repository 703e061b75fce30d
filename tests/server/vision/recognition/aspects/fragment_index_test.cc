#include "server/vision/recognition/aspects/fragment_index.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

namespace horopter {
namespace {

constexpr float kRadius = 0.5f;  // rad, as votes look

FragmentPiece RandomPiece(int entries, float spread_rad, std::mt19937* rng) {
  std::normal_distribution<float> angle(0.0f, spread_rad);
  FragmentPiece piece;
  piece.aspects.emplace_back();
  piece.first_points.emplace_back();
  for (int i = 0; i < entries; ++i) {
    FragmentKey key;
    for (float& a : key) a = angle(*rng);
    IndexedFragment fragment;
    fragment.aspect = 0;
    fragment.x = static_cast<float>(i);
    piece.entries.push_back({PackKey(key), fragment});
  }
  return piece;
}

std::vector<std::uint32_t> Scan(const FragmentIndex& index, const FragmentKey& key) {
  const FragmentKey rounded = UnpackKey(PackKey(key));
  std::vector<std::uint32_t> found;
  for (std::size_t f = 0; f < index.keys.size(); ++f) {
    if (SquaredDistance(rounded, UnpackKey(index.keys[f])) <= kRadius * kRadius)
      found.push_back(static_cast<std::uint32_t>(f));
  }
  return found;
}

TEST(FragmentIndex, FindsWhatAScanFindsWhereCellsHoldLittle) {
  constexpr unsigned kSeed = 7;
  std::mt19937 rng(kSeed);
  const FragmentPiece piece = RandomPiece(12000, 0.6f, &rng);
  const std::array<const FragmentPiece*, 1> pieces = {&piece};
  const auto index = BuildFragmentIndex(pieces);
  ASSERT_TRUE(index.ok());
  std::normal_distribution<float> angle(0.0f, 0.5f);
  for (int trial = 0; trial < 50; ++trial) {
    FragmentKey key;
    for (float& a : key) a = angle(rng);
    std::vector<std::uint32_t> found;
    index->Find(key, kRadius, &found);
    std::sort(found.begin(), found.end());
    const std::vector<std::uint32_t> all = Scan(*index, key);
    // Rounding decides at the border of the ball.
    EXPECT_NEAR(static_cast<double>(found.size()), static_cast<double>(all.size()), 2.0)
        << "seed " << kSeed << " trial " << trial;
  }
}

// Common shapes match tens of thousands of fragments: a share of them is looked at, of all models
// alike.
TEST(FragmentIndex, FindsAnEvenShareWhereCellsHoldMuch) {
  constexpr unsigned kSeed = 8;
  std::mt19937 rng(kSeed);
  const FragmentPiece first = RandomPiece(60000, 0.05f, &rng);
  const FragmentPiece second = RandomPiece(30000, 0.05f, &rng);
  const std::array<const FragmentPiece*, 2> pieces = {&first, &second};
  const auto index = BuildFragmentIndex(pieces);
  ASSERT_TRUE(index.ok());
  std::vector<std::uint32_t> found;
  index->Find(FragmentKey{}, kRadius, &found);
  const std::size_t all = Scan(*index, FragmentKey{}).size();
  ASSERT_GT(all, 80000u) << "seed " << kSeed;
  EXPECT_LT(found.size(), all / 3);
  EXPECT_GT(found.size(), 5000u);
  const auto of_second = std::count_if(found.begin(), found.end(), [&](std::uint32_t f) {
    return index->aspects[index->fragments[f].aspect].model == 1;
  });
  EXPECT_NEAR(static_cast<double>(of_second) / static_cast<double>(found.size()), 1.0 / 3, 0.05);
}

}  // namespace
}  // namespace horopter
