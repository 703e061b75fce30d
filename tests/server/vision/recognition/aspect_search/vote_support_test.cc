#include "server/vision/recognition/aspect_search/vote_support.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>

namespace horopter {
namespace {

constexpr int kWidth = 160, kHeight = 120;

// Half maps of random distances; nothing else of an image is asked.
AspectImage RandomMaps(std::mt19937* random) {
  AspectImage image;
  image.width = kWidth;
  image.height = kHeight;
  image.half_width = kWidth / 2;
  image.half_height = kHeight / 2;
  image.half_distance.resize(static_cast<std::size_t>(kAspectBins) * image.half_width *
                             image.half_height);
  std::uniform_int_distribution<int> distance(0, 255);
  for (std::uint8_t& d : image.half_distance) d = static_cast<std::uint8_t>(distance(*random));
  return image;
}

// Point by point, as the map says.
float Plain(const CoarseMap& map,
            const FirstVotePoints& points,
            int from,
            int to,
            const Similarity& s,
            int tau8) {
  const float cells = 1.0f / static_cast<float>(map.cell_px);
  const float unit = cells / FirstVotePoints::kPlaceScale;
  int sum = 0;
  for (int i = from; i < to; ++i) {
    const float px = points.x[i], py = points.y[i];
    const float a = s.a * unit, b = s.b * unit;
    const float x = a * px - b * py + ((s.x + 0.5f) * cells + 1.0f);
    const float y = b * px + a * py + ((s.y + 0.5f) * cells + 1.0f);
    const int cx = static_cast<int>(std::clamp(x, 0.0f, static_cast<float>(map.width - 1)));
    const int cy = static_cast<int>(std::clamp(y, 0.0f, static_cast<float>(map.height - 1)));
    const int turn = static_cast<int>(TurnBins(s.turn) * FirstVotePoints::kBinSteps);
    const int bin = (points.bin[i] + turn) / FirstVotePoints::kBinSteps % kAspectBins;
    const std::size_t at = (static_cast<std::size_t>(bin) * map.height + cy) * map.width + cx;
    sum += std::max(0, tau8 - map.distance[at]);
  }
  return static_cast<float>(sum) / static_cast<float>(tau8 * (to - from));
}

TEST(CoarseMapSupport, EightPointsAtOnceSayWhatEachSays) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    const AspectImage image = RandomMaps(&random);
    std::uniform_int_distribution<int> step(-32767, 32767);
    std::uniform_int_distribution<int> bin(0, kAspectBins * FirstVotePoints::kBinSteps - 1);
    std::uniform_real_distribution<float> turn(-7.0f, 7.0f), size(5.0f, 300.0f);
    std::uniform_real_distribution<float> x(0.0f, kWidth), y(0.0f, kHeight);
    for (const int cell : {2, 4}) {
      const CoarseMap map(image, cell);
      for (int trial = 0; trial < 50; ++trial) {
        FirstVotePoints points;
        for (int i = 0; i < kFirstVotePoints; ++i) {
          points.x[i] = static_cast<std::int16_t>(step(random));
          points.y[i] = static_cast<std::int16_t>(step(random));
          points.bin[i] = static_cast<std::uint16_t>(bin(random));
        }
        Similarity s = MakeSimilarity(size(random), turn(random));
        s.x = x(random);
        s.y = y(random);
        for (const auto& [from, to] : {std::pair{0, 6}, {6, 16}, {0, 16}, {3, 4}, {8, 16}})
          EXPECT_EQ(map.Support(points, from, to, s, 77), Plain(map, points, from, to, s, 77));
      }
    }
  }
}

// The largest bins and a turn of nearly a half circle go around twice.
TEST(CoarseMapSupport, DirectionsGoAround) {
  std::mt19937 random(7);
  const CoarseMap map(RandomMaps(&random), 2);
  FirstVotePoints points;
  points.bin.fill(kAspectBins * FirstVotePoints::kBinSteps - 1);
  for (const float turn : {3.1415f, -1e-4f, 6.2831f, 0.0f}) {
    Similarity s = MakeSimilarity(40.0f, turn);
    s.x = 60.0f;
    s.y = 50.0f;
    EXPECT_EQ(map.Support(points, 0, 16, s, 120), Plain(map, points, 0, 16, s, 120)) << turn;
  }
}

}  // namespace
}  // namespace horopter
