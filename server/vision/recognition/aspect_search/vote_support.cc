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
  float t = turn * std::numbers::inv_pi_v<float>;
  t -= std::floor(t);
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

float CoarseMap::Support(
    const PackedVotePoint* points, int from, int to, const Similarity& s, int tau8) const {
  const float cells = 1.0f / static_cast<float>(cell_px);
  const float unit = cells / PackedVotePoint::kPlaceScale;
  const float a = s.a * unit, b = s.b * unit;
  const float x0 = (s.x + 0.5f) * cells + 1.0f, y0 = (s.y + 0.5f) * cells + 1.0f;
  const int turn = static_cast<int>(TurnBins(s.turn) * PackedVotePoint::kBinSteps);
  const float right = static_cast<float>(width - 1), bottom = static_cast<float>(height - 1);
  int sum = 0;
  for (int i = from; i < to; ++i) {
    const float px = points[i].x, py = points[i].y;
    const int x = static_cast<int>(std::clamp(a * px - b * py + x0, 0.0f, right));
    const int y = static_cast<int>(std::clamp(b * px + a * py + y0, 0.0f, bottom));
    const int bin = kBins.bin[(points[i].bin + turn) / PackedVotePoint::kBinSteps];
    sum += std::max(0, tau8 - distance[(static_cast<std::size_t>(bin) * height + y) * width + x]);
  }
  return static_cast<float>(sum) / static_cast<float>(tau8 * (to - from));
}

const CoarseMap& CoarseMaps::For(int tau8) const {
  return tau8 >= kQuarterTau8 ? quarter : half;
}

}  // namespace horopter
