#include "server/vision/recognition/aspects/near_keys.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "tests/support/random.h"

namespace horopter {
namespace {

std::vector<PackedFragmentKey> RandomKeys(int count, Random* random) {
  std::vector<PackedFragmentKey> keys;
  for (int i = 0; i < count; ++i) {
    FragmentKey key;
    // Some far beyond any that are alike.
    const double most = i % 10 == 0 ? 12.0 : 0.6;
    for (float& angle : key) angle = static_cast<float>(random->Uniform(-most, most));
    keys.push_back(PackKey(key));
  }
  return keys;
}

double Distance(const PackedFragmentKey& a, const PackedFragmentKey& b) {
  return std::sqrt(static_cast<double>(SquaredSteps(a, b))) / kKeyScale;
}

TEST(CoarseKeys, FindsWhatIsWithinTheRadius) {
  Random random(7);
  // No multiple of the lanes.
  const std::vector<PackedFragmentKey> keys = RandomKeys(1003, &random);
  const CoarseKeys coarse{keys};
  const float radius = 0.51f, slack = 0.045f;  // of rounding to 1 / 64 rad, at eight angles
  std::vector<CoarseKeys::Near> near(keys.size() + CoarseKeys::kLanes);
  std::size_t within = 0;
  for (std::size_t q = 0; q < keys.size(); q += 13) {
    const std::uint32_t begin = static_cast<std::uint32_t>(q / 2), end = 1003;
    const std::size_t n = coarse.Find(
        CoarseKeys::Coarse(keys[q]), begin, end, CoarseKeys::LimitOf(radius), near.data());
    std::vector<bool> found(keys.size(), false);
    for (std::size_t i = 0; i < n; ++i) {
      ASSERT_GE(near[i].number, begin);
      ASSERT_LT(near[i].number, end);
      found[near[i].number] = true;
      EXPECT_LE(Distance(keys[q], keys[near[i].number]), CoarseKeys::RadiusOf(near[i].squared));
    }
    for (std::uint32_t f = begin; f < end; ++f) {
      const double distance = Distance(keys[q], keys[f]);
      if (distance < radius - slack) EXPECT_TRUE(found[f]) << distance;
      if (distance > radius + slack) EXPECT_FALSE(found[f]) << distance;
      within += distance < radius - slack ? 1 : 0;
    }
  }
  EXPECT_GT(within, 100u);
}

TEST(CoarseKeys, NothingIsFoundInNothing) {
  const CoarseKeys none;
  EXPECT_EQ(none.bytes(), 0u);
  const CoarseKeys empty{std::vector<PackedFragmentKey>{}};
  std::array<CoarseKeys::Near, CoarseKeys::kLanes> near;
  EXPECT_EQ(empty.Find({}, 0, 0, 100, near.data()), 0u);
}

TEST(NearestKeys, TakesTheNearestInAnyOrder) {
  Random random(11);
  std::vector<std::pair<int, std::uint32_t>> all;  // squared difference, number
  for (std::uint32_t i = 0; i < 2000; ++i)
    all.emplace_back(static_cast<int>(std::pow(random.Uniform(0.0, 1.2), 4.0) * 1000.0), i);
  constexpr int kLimit = 1000;
  std::vector<std::pair<int, std::uint32_t>> sorted = all;
  std::sort(sorted.begin(), sorted.end());
  std::erase_if(sorted, [](const auto& k) { return k.first > kLimit; });
  std::mt19937 shuffle(3);
  for (const std::size_t most : {0u, 1u, 17u, 120u, 5000u}) {
    std::vector<std::uint32_t> expected;
    for (std::size_t i = 0; i < std::min(most, sorted.size()); ++i)
      expected.push_back(sorted[i].second);
    std::sort(expected.begin(), expected.end());
    for (int run = 0; run < 3; ++run) {
      NearestKeys nearest(kLimit, most);
      for (const auto& [squared, number] : all) nearest.Offer(number, squared);
      std::vector<std::uint32_t> taken;
      nearest.Take(&taken);
      EXPECT_EQ(taken, expected) << most;
      std::shuffle(all.begin(), all.end(), shuffle);
    }
  }
}

TEST(NearestKeys, AsksForNothingFartherOnceThereIsEnough) {
  NearestKeys nearest(6400, 10);
  for (std::uint32_t i = 0; i < 10; ++i) nearest.Offer(i, 150);
  EXPECT_LT(nearest.limit(), 6400);
  EXPECT_GE(nearest.limit(), 150);
}

}  // namespace
}  // namespace horopter
