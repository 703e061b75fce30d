#include "server/index/box_kernels.h"

#include <algorithm>
#include <bit>

#include "server/base/target_clones.h"

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
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
  size_t step;
  int begin;
  int end;
  int count;
};

HOROPTER_TARGET_CLONES
void AccumulatePoints(const Rows& rows, const double* center, double* __restrict squared) {
  for (int d = rows.begin; d < rows.end; ++d) {
    const double* at = rows.low + static_cast<size_t>(d) * rows.step;
    const double c = center[d];
    for (int i = 0; i < rows.count; ++i) {
      const double t = at[i] - c;
      squared[i] += t * t;
    }
  }
}

HOROPTER_TARGET_CLONES
void AccumulateBoxes(const Rows& rows, const double* center, double* __restrict squared) {
  for (int d = rows.begin; d < rows.end; ++d) {
    const double* low = rows.low + static_cast<size_t>(d) * rows.step;
    const double* high = rows.high + static_cast<size_t>(d) * rows.step;
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

HOROPTER_TARGET_CLONES
bool AllAbove(const double* values, int count, double bound) {
  int64_t within = 0;
  for (int i = 0; i < count; ++i) within |= values[i] <= bound ? 1 : 0;
  return within == 0;
}

// Bit i: [low[i], high[i]] meets [from, to], of `count` <= 64 entries.
using OneDimension =
    uint64_t (*)(const double* low, const double* high, double from, double to, int count);

uint64_t PlainTest(const double* low, const double* high, double from, double to, int count) {
  uint64_t meeting = 0;
  for (int i = 0; i < count; ++i) {
    const bool meets = low[i] <= to && high[i] >= from;
    meeting |= static_cast<uint64_t>(meets) << i;
  }
  return meeting;
}

#if defined(__x86_64__) && defined(__GNUC__)
__attribute__((target("avx2"))) uint64_t Avx2Test(
    const double* low, const double* high, double from, double to, int count) {
  const __m256d least = _mm256_set1_pd(from), most = _mm256_set1_pd(to);
  uint64_t meeting = 0;
  for (int i = 0; i < count; i += 4) {  // rows are whole registers long
    const __m256d below = _mm256_cmp_pd(_mm256_loadu_pd(low + i), most, _CMP_LE_OQ);
    const __m256d above = _mm256_cmp_pd(_mm256_loadu_pd(high + i), least, _CMP_GE_OQ);
    const int both = _mm256_movemask_pd(_mm256_and_pd(below, above));
    meeting |= static_cast<uint64_t>(both) << i;
  }
  return meeting;
}

OneDimension FastestTest() {
  return __builtin_cpu_supports("avx2") ? Avx2Test : PlainTest;
}
#else
OneDimension FastestTest() {
  return PlainTest;
}
#endif

uint64_t RemainingDimensions(
    const Node& node, int first, int d, const double* low, const double* high, uint64_t meeting) {
  for (uint64_t left = meeting; left != 0; left &= left - 1) {
    const int bit = std::countr_zero(left), i = first + bit;
    for (int k = d; k < node.dimensions; ++k) {
      if (node.Low(k)[i] > high[k] || node.High(k)[i] < low[k]) {
        meeting &= ~(uint64_t{1} << bit);
        break;
      }
    }
  }
  return meeting;
}

}  // namespace

uint64_t MeetingEntries(const Node& node, int first, const double* low, const double* high) {
  static const OneDimension test = FastestTest();
  const int count = std::min(64, node.count - first);
  uint64_t meeting = count == 64 ? ~uint64_t{0} : (uint64_t{1} << count) - 1;
  // Most entries of a small box's query fall out in the first dimensions; for the up to three that
  // are left their own coordinates are cheaper than everybody's. Cleared bit by bit: counting them
  // is a call where the processor is not known to have the instruction.
  const auto few = [](uint64_t bits) {
    for (int i = 0; i < 3; ++i) bits &= bits - 1;
    return bits == 0;
  };
  for (int d = 0; d < node.dimensions; ++d) {
    if (few(meeting)) return RemainingDimensions(node, first, d, low, high, meeting);
    meeting &= test(node.Low(d) + first, node.High(d) + first, low[d], high[d], count);
  }
  return meeting;
}

bool SquaredDistances(const Node& node, const double* center, double bound, double* squared) {
  Rows rows{node.Low(0), node.High(0), node.row_step(), 0, 0, Rounded(node)};
  std::fill_n(squared, rows.count, 0.0);
  while (true) {
    rows.end = std::min(rows.begin + kDimensionsPerCheck, node.dimensions);
    if (!node.has_high) {
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
