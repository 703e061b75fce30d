#include "server/vision/recognition/aspects/key_cells.h"

#include <tuple>

namespace horopter {

std::vector<KeyCells::Row> KeyCells::RowsAround(const Eigen::Array3f& place, float reach) const {
  // Squared distance of the place from the cells [i, i + 1); border cells reach to infinity.
  const auto away = [&](int d, int i) {
    const float under = i == 0 ? 0.0f : static_cast<float>(i) - place[d];
    const float over = i == counts[d] - 1 ? 0.0f : place[d] - static_cast<float>(i + 1);
    const float by = std::max(0.0f, std::max(under, over));
    return by * by;
  };
  std::vector<Row> rows;
  for (int i = At(0, place[0] - reach); i <= At(0, place[0] + reach); ++i) {
    for (int j = At(1, place[1] - reach); j <= At(1, place[1] + reach); ++j) {
      const float by = away(0, i) + away(1, j);
      if (by <= reach * reach) rows.push_back({by, (i * counts[1] + j) * counts[2]});
    }
  }
  std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) {
    return std::tie(a.away, a.first_cell) < std::tie(b.away, b.first_cell);
  });
  return rows;
}

}  // namespace horopter
