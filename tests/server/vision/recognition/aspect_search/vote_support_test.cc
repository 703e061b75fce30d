#include "server/vision/recognition/aspect_search/vote_support.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace horopter {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

AspectImage RandomMaps(std::mt19937* rng) {
  AspectImage image;
  image.half_width = 80;
  image.half_height = 60;
  std::uniform_int_distribution<int> distance(0, 255);
  image.half_distance.resize(static_cast<std::size_t>(kAspectBins) * 80 * 60);
  for (std::uint8_t& d : image.half_distance) d = static_cast<std::uint8_t>(distance(*rng));
  return image;
}

// One point after the other.
int PlainSupports(
    const CoarseMap& map, const FirstVotePoints& points, int batch, const Similarity& s, int tau8) {
  int sum = 0;
  for (int i = batch * kVoteBatch; i < (batch + 1) * kVoteBatch; ++i) {
    const float unit = 1.0f / (static_cast<float>(map.cell_px) * FirstVotePoints::kPlaceScale);
    const float px = points.x[i], py = points.y[i];
    const float cell = static_cast<float>(map.cell_px);
    const float x = s.a * unit * px - s.b * unit * py + (s.x + 0.5f) * (1.0f / cell) + 1.0f;
    const float y = s.b * unit * px + s.a * unit * py + (s.y + 0.5f) * (1.0f / cell) + 1.0f;
    const int cx = static_cast<int>(std::clamp(x, 0.0f, static_cast<float>(map.width - 1)));
    const int cy = static_cast<int>(std::clamp(y, 0.0f, static_cast<float>(map.height - 1)));
    const int turn = static_cast<int>(TurnBins(s.turn) * FirstVotePoints::kBinSteps);
    const int bin = (points.bin[i] + turn) / FirstVotePoints::kBinSteps % kAspectBins;
    sum += std::max(0, tau8 - map.distance[(bin * map.height + cy) * map.width + cx]);
  }
  return sum;
}

TEST(VoteSupport, BatchesAreTheSumOfTheirPoints) {
  constexpr unsigned kSeed = 22;
  std::mt19937 rng(kSeed);
  std::uniform_int_distribution<int> place(-16384, 16384);
  std::uniform_int_distribution<int> bin(0, kAspectBins * FirstVotePoints::kBinSteps - 1);
  std::uniform_real_distribution<float> turn(-9.0f, 9.0f), x(0.0f, 160.0f), y(0.0f, 120.0f);
  std::uniform_real_distribution<float> size(10.0f, 300.0f);  // reaches out of the image
  const AspectImage image = RandomMaps(&rng);
  const CoarseMaps maps(image);
  for (int trial = 0; trial < 500; ++trial) {
    FirstVotePoints points;
    for (int i = 0; i < kFirstVotePoints; ++i) {
      points.x[i] = static_cast<std::int16_t>(place(rng));
      points.y[i] = static_cast<std::int16_t>(place(rng));
      points.bin[i] = static_cast<std::int16_t>(bin(rng));
    }
    Similarity s = MakeSimilarity(size(rng), turn(rng));
    s.x = x(rng);
    s.y = y(rng);
    for (const CoarseMap* map : {&maps.half, &maps.quarter}) {
      for (const int batch : {0, 1}) {
        EXPECT_EQ(map->Supports(points, batch, s, 60), PlainSupports(*map, points, batch, s, 60))
            << "seed " << kSeed << " trial " << trial;
      }
    }
  }
}

TEST(VoteSupport, HalfTurnsDoNotChangeBins) {
  for (float turn = -6.0f; turn < 6.0f; turn += 0.37f) {
    const float bins = TurnBins(turn);
    EXPECT_GE(bins, 0.5f);
    EXPECT_LT(bins, kAspectBins + 0.5f + 1e-3f);
    for (const int halves : {-3, -1, 2}) {
      const float other = TurnBins(turn + static_cast<float>(halves) * kPi);
      const float off = std::abs(other - bins);
      EXPECT_LT(std::min(off, kAspectBins - off), 1e-3f) << turn << " " << halves;
    }
  }
}

}  // namespace
}  // namespace horopter
