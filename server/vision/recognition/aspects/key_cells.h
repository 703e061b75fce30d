// The cells of a grid that sorts fragment keys: places along three axes, in cells.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <vector>

namespace horopter {

// Cell (i, j, k) is number (i * counts[1] + j) * counts[2] + k. Places beyond the border belong to
// the cells there.
struct KeyCells {
  Eigen::Array3i counts = Eigen::Array3i::Zero();

  // Cells (i, j, all k), from the first on.
  struct Row {
    float away;  // squared, cells: from the place that is searched
    int first_cell;
  };
  // Those that reach so near to a place; nearest first.
  std::vector<Row> RowsAround(const Eigen::Array3f& place, float reach) const;

  int total() const { return counts.prod(); }
  // Of a place along an axis.
  int At(int axis, float place) const {
    return std::clamp(static_cast<int>(std::floor(place)), 0, counts[axis] - 1);
  }
  int NumberAt(const Eigen::Array3f& place) const {
    return (At(0, place[0]) * counts[1] + At(1, place[1])) * counts[2] + At(2, place[2]);
  }
};

}  // namespace horopter
