#include "server/vision/matching/keypoint_matching.h"

#include <algorithm>
#include <cstdint>
#include <limits>

#include "server/base/stop_scope.h"
#include "server/base/target_clones.h"

namespace horopter {
namespace {

struct Nearest {
  std::int32_t best = std::numeric_limits<std::int32_t>::max();
  std::int32_t second = std::numeric_limits<std::int32_t>::max();
  int index = -1;

  void Offer(std::int32_t distance, int i) {
    if (distance < best) {
      second = best;
      best = distance;
      index = i;
    } else if (distance < second) {
      second = distance;
    }
  }
};

// Inner products of one descriptor with `count` consecutive ones.
HOROPTER_TARGET_CLONES void Dots(const std::int16_t* a,
                                 const std::int16_t* b,
                                 int count,
                                 std::int32_t* dots) {
  int j = 0;
  for (; j + 4 <= count; j += 4, b += 4 * kDescriptorLength) {
    std::int32_t s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    for (int k = 0; k < kDescriptorLength; ++k) {
      s0 += static_cast<std::int32_t>(a[k]) * b[k];
      s1 += static_cast<std::int32_t>(a[k]) * b[k + kDescriptorLength];
      s2 += static_cast<std::int32_t>(a[k]) * b[k + 2 * kDescriptorLength];
      s3 += static_cast<std::int32_t>(a[k]) * b[k + 3 * kDescriptorLength];
    }
    dots[j] = s0;
    dots[j + 1] = s1;
    dots[j + 2] = s2;
    dots[j + 3] = s3;
  }
  for (; j < count; ++j, b += kDescriptorLength) {
    std::int32_t s = 0;
    for (int k = 0; k < kDescriptorLength; ++k) s += static_cast<std::int32_t>(a[k]) * b[k];
    dots[j] = s;
  }
}

}  // namespace

std::vector<std::pair<int, int>> MatchKeypointIndices(const KeypointSet& a,
                                                      const KeypointSet& b,
                                                      double ratio) {
  std::vector<Nearest> of_a(a.size()), of_b(b.size());
  constexpr int kBlock = 64;  // rows of b that stay in the cache while all of a passes
  for (int j0 = 0; j0 < b.size(); j0 += kBlock) {
    LeaveIfStopped();
    const int j1 = std::min(j0 + kBlock, b.size());
    for (int i = 0; i < a.size(); ++i) {
      std::int32_t dots[kBlock];
      Dots(&a.descriptors[static_cast<size_t>(i) * kDescriptorLength],
           &b.descriptors[static_cast<size_t>(j0) * kDescriptorLength],
           j1 - j0,
           dots);
      for (int j = j0; j < j1; ++j) {
        const std::int32_t distance = a.squared_norms[i] + b.squared_norms[j] - 2 * dots[j - j0];
        of_a[i].Offer(distance, j);
        of_b[j].Offer(distance, i);
      }
    }
  }
  std::vector<std::pair<double, int>> order;
  for (int i = 0; i < a.size(); ++i) {
    const Nearest& n = of_a[i];
    if (n.index < 0 || of_b[n.index].index != i) continue;
    const double squared_ratio = n.best / std::max(1.0, static_cast<double>(n.second));
    if (squared_ratio < ratio * ratio) order.emplace_back(squared_ratio, i);
  }
  std::sort(order.begin(), order.end());
  std::vector<std::pair<int, int>> pairs;
  pairs.reserve(order.size());
  for (const auto& [unused, i] : order) pairs.emplace_back(i, of_a[i].index);
  return pairs;
}

std::vector<PointPair> MatchKeypoints(const KeypointSet& a, const KeypointSet& b, double ratio) {
  std::vector<PointPair> pairs;
  for (const auto& [i, j] : MatchKeypointIndices(a, b, ratio))
    pairs.push_back({a.points[i], b.points[j]});
  return pairs;
}

}  // namespace horopter
