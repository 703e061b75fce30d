#include "server/index/box_kernels.h"

#include <algorithm>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define HOROPTER_WIDEST_VECTORS __attribute__((target_clones("avx2", "default")))
#else
#define HOROPTER_WIDEST_VECTORS
#endif

namespace horopter::index_internal {
namespace {

// Whole registers: the places behind the last entry are infinite and harmless.
int Rounded(const Node& node) {
  return (node.count + 3) / 4 * 4;
}

// Dimensions added between two looks at whether to go on.
constexpr int kDimensionsPerCheck = 4;

// Rows of the bounds that one call works on: dimensions [begin, end).
struct Rows {
  const double* low;
  const double* high;
  int stride;
  int begin;
  int end;
  int count;
};

HOROPTER_WIDEST_VECTORS
void AccumulateExcess(const Rows& rows,
                      const double* query_low,
                      const double* query_high,
                      double* __restrict excess) {
  for (int d = rows.begin; d < rows.end; ++d) {
    const double* low = rows.low + static_cast<size_t>(d) * rows.stride;
    const double* high = rows.high + static_cast<size_t>(d) * rows.stride;
    const double from = query_low[d], to = query_high[d];
    for (int i = 0; i < rows.count; ++i) {
      const double above = low[i] - to;
      const double below = from - high[i];
      const double worse = above > below ? above : below;
      excess[i] = excess[i] > worse ? excess[i] : worse;
    }
  }
}

HOROPTER_WIDEST_VECTORS
void AccumulatePoints(const Rows& rows, const double* center, double* __restrict squared) {
  for (int d = rows.begin; d < rows.end; ++d) {
    const double* at = rows.low + static_cast<size_t>(d) * rows.stride;
    const double c = center[d];
    for (int i = 0; i < rows.count; ++i) {
      const double t = at[i] - c;
      squared[i] += t * t;
    }
  }
}

HOROPTER_WIDEST_VECTORS
void AccumulateBoxes(const Rows& rows, const double* center, double* __restrict squared) {
  for (int d = rows.begin; d < rows.end; ++d) {
    const double* low = rows.low + static_cast<size_t>(d) * rows.stride;
    const double* high = rows.high + static_cast<size_t>(d) * rows.stride;
    const double c = center[d];
    for (int i = 0; i < rows.count; ++i) {
      const double below = low[i] - c;
      const double above = c - high[i];
      const double outside = below > above ? below : above;
      const double t = outside > 0.0 ? outside : 0.0;
      squared[i] += t * t;
    }
  }
}

HOROPTER_WIDEST_VECTORS
bool AllAbove(const double* values, int count, double bound) {
  int64_t within = 0;
  for (int i = 0; i < count; ++i) within |= values[i] <= bound ? 1 : 0;
  return within == 0;
}

}  // namespace

void BoxExcess(const Node& node, const double* low, const double* high, double* excess) {
  Rows rows{node.Low(0), node.High(0), node.stride, 0, 0, Rounded(node)};
  std::fill_n(excess, rows.count, -1.0);
  while (true) {
    rows.end = std::min(rows.begin + kDimensionsPerCheck, node.dimensions);
    AccumulateExcess(rows, low, high, excess);
    if (rows.end == node.dimensions || AllAbove(excess, rows.count, 0.0)) return;
    rows.begin = rows.end;
  }
}

bool SquaredDistances(const Node& node, const double* center, double bound, double* squared) {
  Rows rows{node.Low(0), node.High(0), node.stride, 0, 0, Rounded(node)};
  std::fill_n(squared, rows.count, 0.0);
  while (true) {
    rows.end = std::min(rows.begin + kDimensionsPerCheck, node.dimensions);
    if (node.high.empty()) {
      AccumulatePoints(rows, center, squared);
    } else {
      AccumulateBoxes(rows, center, squared);
    }
    if (rows.end == node.dimensions) return true;
    if (AllAbove(squared, rows.count, bound)) return false;
    rows.begin = rows.end;
  }
}

}  // namespace horopter::index_internal
