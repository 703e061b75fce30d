// Counts node accesses of dynamic trees in X-tree and R*-tree mode, as the X-tree paper does.
//
//   index_accesses [COUNT]      points (default 100000)
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>

#include "tests/bench/index_data.h"

namespace horopter {
namespace {

// Dynamic insertion into pages of 4 KiB, as in the paper; point and 10-NN queries.
void CountAccesses(const std::string& name, int dimensions, int count) {
  IndexData data = GenerateIndexData(name == "uniform" ? name : "clustered", dimensions, count, 5);
  const bool boxes = name == "boxes";
  const int entry_bytes = 8 * dimensions + 8;
  double point[2], nearest[2];
  int64_t supernodes = 0;
  for (const IndexMode mode : {IndexMode::kXTree, IndexMode::kRStarTree}) {
    XTree tree = XTree::Create({.dimensions = dimensions,
                                .boxes = boxes,
                                .mode = mode,
                                .leaf_capacity = 4096 / (boxes ? 2 * entry_bytes - 8 : entry_bytes),
                                .directory_capacity = 4096 / (2 * entry_bytes - 8)})
                     .value();
    for (int i = 0; i < count; ++i) {
      const std::span<const double> at(data.Row(i), dimensions);
      std::vector<double> high(at.begin(), at.end());
      if (boxes) {
        for (double& x : high) x += 0.05;
      }
      (void)tree.InsertBox(at, high, i);
    }
    QueryStats points, neighbours;
    std::mt19937 rng(3);
    constexpr int kQueries = 300;
    for (int q = 0; q < kQueries; ++q) {
      const std::span<const double> at(data.Row(static_cast<int>(rng() % count)), dimensions);
      tree.view().Box(at, at, &points);
      tree.view().Nearest(at, kNearestCount, &neighbours);
    }
    const int m = static_cast<int>(mode);
    point[m] = static_cast<double>(points.accesses()) / kQueries;
    nearest[m] = static_cast<double>(neighbours.accesses()) / kQueries;
    if (mode == IndexMode::kXTree) supernodes = tree.view().Memory().supernodes;
  }
  std::printf("| %s | %d | %d | %.1f | %.1f | %.2f | %.1f | %.1f | %.2f | %lld |\n",
              name.c_str(),
              dimensions,
              count,
              point[0],
              point[1],
              point[1] / point[0],
              nearest[0],
              nearest[1],
              nearest[1] / nearest[0],
              static_cast<long long>(supernodes));
  std::fflush(stdout);
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  const int count = argc > 1 ? std::atoi(argv[1]) : 100000;
  std::printf(
      "| data | d | n | point: X | R* | R*/X | 10-NN: X | R* | R*/X | supernodes |\n"
      "|---|---|---|---|---|---|---|---|---|---|\n");
  for (const char* name : {"uniform", "clustered", "boxes"}) {
    for (const int d : {2, 4, 8, 16}) horopter::CountAccesses(name, d, count);
  }
  return 0;
}
