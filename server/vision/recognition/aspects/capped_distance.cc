#include "server/vision/recognition/aspects/capped_distance.h"

#include <algorithm>
#include <cstddef>
#include <vector>

namespace horopter {
namespace {

using Units = std::int16_t;  // eight at once in a register; 1/960 px, so that 32 px fit

constexpr int kUnitsPerStep = 120;  // a step is 1/8 px
constexpr int kAlong = 917, kAcross = 1315;
constexpr int kFar = 255 * kUnitsPerStep;
// Cells beside a row that are far from everything: the longest shift.
constexpr int kBeside = 16;
// Shifts whose sums are all numbers of pixels up to those that kFar can be away along a row.
constexpr int kShifts[] = {1, 2, 4, 8, 16, 2};
static_assert(33 * kAlong <= kFar && 34 * kAlong > kFar);
static_assert(kFar + kAcross < 32767);

// row = min(row, what the neighbouring row, one cell apart at most, is away).
void TakeFromRow(const Units* neighbour, int width, Units* row) {
  for (int x = 0; x < width; ++x) {
    const int across = std::min(neighbour[x - 1], neighbour[x + 1]) + kAcross;
    const int least = std::min(neighbour[x] + kAlong, across);
    row[x] = static_cast<Units>(std::min<int>(row[x], least));
  }
}

// Every cell of `row` from those before it (kSign 1) or behind it (-1); spare: of row's size.
template <int kSign>
void TakeAlongRow(int width, Units* row, Units* spare) {
  Units* from = row;
  Units* to = spare;
  for (const int shift : kShifts) {
    const auto way = static_cast<Units>(shift * kAlong), most = static_cast<Units>(kFar - way);
    const Units* other = from - kSign * shift;
    for (int x = 0; x < width; ++x) {
      const auto near = static_cast<Units>(std::min(other[x], most) + way);
      to[x] = std::min(from[x], near);
    }
    std::swap(from, to);
  }
  static_assert(std::size(kShifts) % 2 == 0);  // the last sum is in `row`
}

}  // namespace

void FillCappedDistance(std::span<const std::uint8_t> marked,
                        int width,
                        int height,
                        std::span<std::uint8_t> distance) {
  const std::size_t stride = static_cast<std::size_t>(width) + 2 * kBeside;
  std::vector<Units> away(stride * (height + 1), kFar);  // a row that is far from all, the others
  std::vector<Units> spare(stride, kFar);
  const auto row = [&](int y) { return away.data() + (y + 1) * stride + kBeside; };
  for (int y = 0; y < height; ++y) {
    const std::uint8_t* in = marked.data() + static_cast<std::size_t>(y) * width;
    for (int x = 0; x < width; ++x) row(y)[x] = in[x] != 0 ? 0 : kFar;
    TakeFromRow(row(y - 1), width, row(y));
    TakeAlongRow<1>(width, row(y), spare.data() + kBeside);
  }
  for (int y = height - 1; y >= 0; --y) {
    if (y + 1 < height) TakeFromRow(row(y + 1), width, row(y));
    TakeAlongRow<-1>(width, row(y), spare.data() + kBeside);
    std::uint8_t* out = distance.data() + static_cast<std::size_t>(y) * width;
    for (int x = 0; x < width; ++x) {
      const auto rounded = static_cast<std::uint16_t>(row(y)[x] + kUnitsPerStep / 2);
      out[x] = static_cast<std::uint8_t>(rounded / kUnitsPerStep);
    }
  }
}

}  // namespace horopter
