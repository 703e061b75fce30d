// Points and queries that the index is measured with.
#pragma once

#include <string>
#include <vector>

#include "server/index/x_tree.h"

namespace horopter {

inline constexpr int kNearestCount = 10;

enum class QueryKind { kPoint, kBox, kNeighbors, kEllipsoid };
inline constexpr QueryKind kQueryKinds[] = {
    QueryKind::kPoint, QueryKind::kBox, QueryKind::kNeighbors, QueryKind::kEllipsoid};
const char* NameOf(QueryKind kind);

struct IndexQuery {
  std::vector<double> center;
  std::vector<double> low;
  std::vector<double> high;
  Ellipsoid ellipsoid;  // gate 1
};

struct IndexData {
  std::string name;
  int dimensions = 0;
  int count = 0;
  std::vector<double> points;  // of boxes the lower corners
  std::vector<double> highs;   // of boxes alone
  std::vector<IndexQuery> queries;

  bool boxes() const { return !highs.empty(); }
  const double* Row(int i) const { return &points[static_cast<size_t>(i) * dimensions]; }
  const double* High(int i) const {
    return boxes() ? &highs[static_cast<size_t>(i) * dimensions] : Row(i);
  }
};

// name: "uniform" in the unit cube, or "clustered": 100 Gaussian clusters of deviation 0.02.
// Without queries.
IndexData GenerateIndexData(const std::string& name, int dimensions, int count, unsigned seed);

// File of key_data: doubles, first the dimension, then point after point; a negative dimension:
// boxes, each low, then high. No points: unreadable.
IndexData ReadIndexKeys(const std::string& path);

// Queries lie at data points; box and ellipsoid are as large as the distance of about the 20th
// neighbour, the ellipsoid with axes of 1 : 1/4 in a random direction. Of boxes they lie at their
// centres and are 0.06 wide, as those of a path seen in an image.
void AddIndexQueries(IndexData& data, int count, unsigned seed);

}  // namespace horopter
