#include "server/vision/recognition/aspect_search/vote_support.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace horopter {
namespace {

// From this tolerance on a cell of 4 x 4 pixels says as much as one of 2 x 2.
constexpr int kQuarterTau8 = 5 * static_cast<int>(AspectImage::kDistanceScale);

struct BinTable {
  std::array<std::uint8_t, 2 * kAspectBins + 2> bin;
  BinTable() {
    for (std::size_t i = 0; i < bin.size(); ++i) bin[i] = i % kAspectBins;
  }
};
const BinTable kBins;

}  // namespace

Similarity MakeSimilarity(float size, float turn) {
  Similarity s;
  s.size = size;
  s.turn = turn;
  s.a = size * std::cos(turn);
  s.b = size * std::sin(turn);
  return s;
}

float TurnBins(float turn) {
  constexpr float kHalfTurns = 64.0f;  // more than any sum of turns has: the cast rounds down
  float t = turn * std::numbers::inv_pi_v<float> + kHalfTurns;
  t -= static_cast<float>(static_cast<int>(t));
  return t * kAspectBins + 0.5f;
}

float Support(const AspectImage& image,
              const VotePoint* points,
              int from,
              int to,
              const Similarity& s,
              int tau8) {
  const float turn_bins = TurnBins(s.turn);
  int sum = 0;
  for (int i = from; i < to; ++i) {
    const VotePoint& p = points[i];
    const float x = s.a * p.x - s.b * p.y + s.x;
    const float y = s.b * p.x + s.a * p.y + s.y;
    const int bin = kBins.bin[static_cast<int>(p.bin + turn_bins)];
    const int d = image.DistanceAt(x, y, bin);
    sum += std::max(0, tau8 - d);
  }
  return static_cast<float>(sum) / static_cast<float>(tau8 * (to - from));
}

float ExcessChance(const AspectImage& image,
                   const VotePoint* points,
                   int n,
                   const Similarity& s,
                   int tau8,
                   double free_chance) {
  const float turn_bins = TurnBins(s.turn);
  const int level =
      AspectImage::ChanceLevel(static_cast<float>(tau8) / AspectImage::kDistanceScale);
  int sum = 0;
  for (int i = 0; i < n; ++i) {
    const VotePoint& p = points[i];
    const float x = s.a * p.x - s.b * p.y + s.x;
    const float y = s.b * p.x + s.a * p.y + s.y;
    if (!(x >= 0 && y >= 0 && x < image.width && y < image.height)) continue;
    sum += image.ChanceAt(x, y, TurnedBin(p.bin + turn_bins), level);
  }
  const float chance = static_cast<float>(sum) / (255.0f * static_cast<float>(n));
  return std::max(0.0f, chance - static_cast<float>(free_chance));
}

CoarseMap::CoarseMap(const AspectImage& image, int cell) : cell_px(cell) {
  const int step = cell / 2;  // cells of the half map
  const int w = (image.half_width + step - 1) / step, h = (image.half_height + step - 1) / step;
  width = w + 2;
  height = h + 2;
  distance.assign(static_cast<std::size_t>(kAspectBins) * width * height, 255);
  for (int bin = 0; bin < kAspectBins; ++bin) {
    const std::uint8_t* half = image.half_distance.data() +
                               static_cast<std::size_t>(bin) * image.half_width * image.half_height;
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        int sum = 0, count = 0;
        for (int v = y * step; v < std::min((y + 1) * step, image.half_height); ++v) {
          for (int u = x * step; u < std::min((x + 1) * step, image.half_width); ++u, ++count)
            sum += half[static_cast<std::size_t>(v) * image.half_width + u];
        }
        distance[(static_cast<std::size_t>(bin) * height + y + 1) * width + x + 1] =
            static_cast<std::uint8_t>(sum / count);
      }
    }
  }
}

// Loops over a batch, without branches: several points a step where the compiler finds registers.
// Numbers of cells are below 2^24, so floats hold them exactly.
int CoarseMap::Supports(const FirstVotePoints& points,
                        int batch,
                        const Similarity& s,
                        int tau8) const {
  const float cells = 1.0f / static_cast<float>(cell_px);
  const float unit = cells / FirstVotePoints::kPlaceScale;
  const float a = s.a * unit, b = s.b * unit;
  const float x0 = (s.x + 0.5f) * cells + 1.0f, y0 = (s.y + 0.5f) * cells + 1.0f;
  const int turn = static_cast<int>(TurnBins(s.turn) * FirstVotePoints::kBinSteps);
  const float right = static_cast<float>(width - 1), bottom = static_cast<float>(height - 1);
  const float row = static_cast<float>(width), plane = static_cast<float>(width * height);
  const std::int16_t* xs = points.x.data() + batch * kVoteBatch;
  const std::int16_t* ys = points.y.data() + batch * kVoteBatch;
  const std::int16_t* bins = points.bin.data() + batch * kVoteBatch;
  constexpr int kAllBins = kAspectBins * FirstVotePoints::kBinSteps;
  std::array<std::int32_t, kVoteBatch> cell;
  for (int i = 0; i < kVoteBatch; ++i) {
    const float px = xs[i], py = ys[i];
    const float x = std::min(std::max(a * px - b * py + x0, 0.0f), right);
    const float y = std::min(std::max(b * px + a * py + y0, 0.0f), bottom);
    int bin = bins[i] + turn;
    bin -= bin >= kAllBins ? kAllBins : 0;
    bin -= bin >= kAllBins ? kAllBins : 0;
    bin /= FirstVotePoints::kBinSteps;
    cell[i] = static_cast<std::int32_t>(static_cast<float>(bin) * plane +
                                        static_cast<float>(static_cast<int>(y)) * row +
                                        static_cast<float>(static_cast<int>(x)));
  }
  int sum = 0;
  for (int i = 0; i < kVoteBatch; ++i) sum += std::max(0, tau8 - distance[cell[i]]);
  return sum;
}

const CoarseMap& CoarseMaps::For(int tau8) const {
  return tau8 >= kQuarterTau8 ? quarter : half;
}

}  // namespace horopter
