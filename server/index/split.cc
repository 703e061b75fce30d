#include "server/index/split.h"

#include <algorithm>
#include <limits>
#include <numeric>

namespace horopter::index_internal {
namespace {

// Bounds of the first 1, 2, .. entries of an order, row-major (entry, dimension).
struct RunningBounds {
  std::vector<double> low;
  std::vector<double> high;
};

template <typename Iterator>
RunningBounds Accumulate(const Node& node, Iterator begin, Iterator end) {
  const size_t dims = node.dimensions;
  const size_t count = end - begin;
  RunningBounds bounds{std::vector<double>(count * dims), std::vector<double>(count * dims)};
  for (size_t d = 0; d < dims; ++d) {
    const double* low = node.Low(static_cast<int>(d));
    const double* high = node.High(static_cast<int>(d));
    double smallest = std::numeric_limits<double>::infinity(), largest = -smallest;
    Iterator at = begin;
    for (size_t i = 0; i < count; ++i, ++at) {
      smallest = std::min(smallest, low[*at]);
      largest = std::max(largest, high[*at]);
      bounds.low[i * dims + d] = smallest;
      bounds.high[i * dims + d] = largest;
    }
  }
  return bounds;
}

struct Distribution {
  double margin = 0.0;
  double overlap = 0.0;
  double volume = 0.0;
};

// The two halves when the first `left` entries of an order of n are split off. Lengths are relative
// to the node's extent, so that volumes neither vanish in many dimensions nor depend on units; a
// dimension without extent counts as 1.
Distribution Measure(const RunningBounds& forward,
                     const RunningBounds& backward,
                     const std::vector<double>& extent,
                     size_t left,
                     size_t n) {
  const size_t dims = extent.size();
  const double* a_low = &forward.low[(left - 1) * dims];
  const double* a_high = &forward.high[(left - 1) * dims];
  const double* b_low = &backward.low[(n - left - 1) * dims];
  const double* b_high = &backward.high[(n - left - 1) * dims];
  Distribution result;
  double a_volume = 1.0, b_volume = 1.0, common = 1.0;
  for (size_t d = 0; d < dims; ++d) {
    if (extent[d] <= 0.0) continue;
    const double a = (a_high[d] - a_low[d]) / extent[d];
    const double b = (b_high[d] - b_low[d]) / extent[d];
    const double both = (std::min(a_high[d], b_high[d]) - std::max(a_low[d], b_low[d])) / extent[d];
    a_volume *= a;
    b_volume *= b;
    common *= std::max(both, 0.0);
    result.margin += a + b;
  }
  result.volume = a_volume + b_volume;
  const double union_volume = result.volume - common;
  result.overlap = union_volume > 0.0 ? common / union_volume : 0.0;
  return result;
}

struct Ordering {
  std::vector<int> order;
  RunningBounds forward;
  RunningBounds backward;
};

Ordering OrderAlong(const Node& node, int d, bool by_high) {
  Ordering result;
  result.order.resize(node.count);
  std::iota(result.order.begin(), result.order.end(), 0);
  const double* first = by_high ? node.High(d) : node.Low(d);
  const double* then = by_high ? node.Low(d) : node.High(d);
  std::sort(result.order.begin(), result.order.end(), [&](int a, int b) {
    if (first[a] != first[b]) return first[a] < first[b];
    if (then[a] != then[b]) return then[a] < then[b];
    return a < b;
  });
  result.forward = Accumulate(node, result.order.begin(), result.order.end());
  result.backward = Accumulate(node, result.order.rbegin(), result.order.rend());
  return result;
}

std::vector<double> Extent(const Node& node) {
  const Entry bounds = node.Bounds();
  std::vector<double> extent(node.dimensions);
  for (int d = 0; d < node.dimensions; ++d) extent[d] = bounds.high[d] - bounds.low[d];
  return extent;
}

Split Take(const Ordering& ordering, size_t left, int dimension, double overlap) {
  Split split;
  split.first.assign(ordering.order.begin(), ordering.order.begin() + static_cast<ptrdiff_t>(left));
  split.second.assign(ordering.order.begin() + static_cast<ptrdiff_t>(left), ordering.order.end());
  split.dimension = dimension;
  split.overlap = overlap;
  return split;
}

}  // namespace

Split TopologicalSplit(const Node& node, int min_count) {
  const std::vector<double> extent = Extent(node);
  const size_t n = node.count, smallest = min_count;
  double best_margin = std::numeric_limits<double>::infinity();
  int axis = 0;
  for (int d = 0; d < node.dimensions; ++d) {
    double margin = 0.0;
    for (const bool by_high : {false, true}) {
      if (by_high && !node.has_high) {
        margin *= 2.0;  // points: both orders are the same
        break;
      }
      const Ordering ordering = OrderAlong(node, d, by_high);
      for (size_t left = smallest; left + smallest <= n; ++left) {
        margin += Measure(ordering.forward, ordering.backward, extent, left, n).margin;
      }
    }
    if (margin < best_margin) {
      best_margin = margin;
      axis = d;
    }
  }
  Split best;
  Distribution least;
  for (const bool by_high : {false, true}) {
    if (by_high && !node.has_high) break;
    const Ordering ordering = OrderAlong(node, axis, by_high);
    size_t best_left = 0;
    for (size_t left = smallest; left + smallest <= n; ++left) {
      const Distribution found = Measure(ordering.forward, ordering.backward, extent, left, n);
      const bool better = (best.first.empty() && best_left == 0) || found.overlap < least.overlap ||
                          (found.overlap == least.overlap && found.volume < least.volume);
      if (better) {
        least = found;
        best_left = left;
      }
    }
    if (best_left > 0) best = Take(ordering, best_left, axis, least.overlap);
  }
  return best;
}

std::optional<Split> OverlapMinimalSplit(const Node& node, int min_count) {
  uint64_t common = ~uint64_t{0};
  for (int i = 0; i < node.count; ++i) common &= node.history[i];
  const std::vector<double> extent = Extent(node);
  const size_t n = node.count, smallest = min_count;
  std::optional<Split> best;
  size_t best_imbalance = 0;
  for (int d = 0; d < node.dimensions; ++d) {
    if ((common >> d & 1) == 0) continue;
    const Ordering ordering = OrderAlong(node, d, false);
    for (size_t left = smallest; left + smallest <= n; ++left) {
      const double overlap = Measure(ordering.forward, ordering.backward, extent, left, n).overlap;
      const size_t imbalance = left > n - left ? 2 * left - n : n - 2 * left;
      if (!best || overlap < best->overlap ||
          (overlap == best->overlap && imbalance < best_imbalance)) {
        best = Take(ordering, left, d, overlap);
        best_imbalance = imbalance;
      }
    }
  }
  return best;
}

}  // namespace horopter::index_internal
