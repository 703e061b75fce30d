#include "server/vision/recognition/aspect_search/vote_support.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "server/base/lanes.h"
#include "server/base/stop_scope.h"
#include "server/base/target_clones.h"

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

constexpr int kBinShift = 8;  // FirstVotePoints::kBinSteps, as a power of two

// From steps of FirstVotePoints to cells of a coarse map.
struct CellTransform {
  float a, b, x0, y0;  // cells a step, cells
  float right, bottom;
  std::int32_t turn;  // steps of a bin, plus half a bin
  std::int32_t width, height;
};

// Sum of tau8 - distance, where positive, over the points [from, to).
HOROPTER_TARGET_CLONES
int SumOfSupport(const std::uint8_t* distance,
                 const FirstVotePoints& points,
                 const CellTransform& t,
                 int from,
                 int to,
                 int tau8) {
  const FloatLanes zero = {};
  int sum = 0;
  for (int begin = from / kLanes * kLanes; begin < to; begin += kLanes) {
    ShortLanes xs, ys;
    UnsignedShortLanes bins;
    LoadLanes(points.x.data() + begin, &xs);
    LoadLanes(points.y.data() + begin, &ys);
    LoadLanes(points.bin.data() + begin, &bins);
    const FloatLanes px = __builtin_convertvector(xs, FloatLanes),
                     py = __builtin_convertvector(ys, FloatLanes);
    const FloatLanes x = t.a * px - t.b * py + t.x0, y = t.b * px + t.a * py + t.y0;
    const FloatLanes left = x < zero ? zero : x, top = y < zero ? zero : y;
    const FloatLanes right = zero + t.right, bottom = zero + t.bottom;
    const IntLanes cx = __builtin_convertvector(left > right ? right : left, IntLanes);
    const IntLanes cy = __builtin_convertvector(top > bottom ? bottom : top, IntLanes);
    IntLanes bin = (__builtin_convertvector(bins, IntLanes) + t.turn) >> kBinShift;
    // A comparison that holds is -1. At most twice around.
    bin += ((bin >= kAspectBins) + (bin >= 2 * kAspectBins)) * kAspectBins;
    const IntLanes cells = (bin * t.height + cy) * t.width + cx;
    const int first = std::max(from - begin, 0), last = std::min(to - begin, kLanes);
    for (int i = first; i < last; ++i) sum += std::max(0, tau8 - distance[cells[i]]);
  }
  return sum;
}

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
    LeaveIfStopped();
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
    const FirstVotePoints& points, int from, int to, const Similarity& s, int tau8) const {
  static_assert(FirstVotePoints::kBinSteps == 1 << kBinShift && kFirstVotePoints % kLanes == 0);
  const float cells = 1.0f / static_cast<float>(cell_px);
  const float unit = cells / FirstVotePoints::kPlaceScale;
  CellTransform t;
  t.a = s.a * unit;
  t.b = s.b * unit;
  t.x0 = (s.x + 0.5f) * cells + 1.0f;
  t.y0 = (s.y + 0.5f) * cells + 1.0f;
  t.right = static_cast<float>(width - 1);
  t.bottom = static_cast<float>(height - 1);
  t.turn = static_cast<std::int32_t>(TurnBins(s.turn) * FirstVotePoints::kBinSteps);
  t.width = width;
  t.height = height;
  const int sum = SumOfSupport(distance.data(), points, t, from, to, tau8);
  return static_cast<float>(sum) / static_cast<float>(tau8 * (to - from));
}

const CoarseMap& CoarseMaps::For(int tau8) const {
  return tau8 >= kQuarterTau8 ? quarter : half;
}

}  // namespace horopter
