// The X-tree and its peers behind one call: the ids of the entries that answer a query.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "tests/bench/index_data.h"

namespace horopter {

struct IndexPeer {
  std::string name;
  // Appends the ids to `found`, in any order.
  std::function<void(const IndexQuery&, QueryKind, std::vector<int64_t>& found)> run;
};

// `data` must outlive the peers. nanoflann has no box query: the ball around the box, then the
// test. Nobody but the X-tree has an ellipsoid query: the box or ball around it, then the test.
// Boxes are asked for what a point or a box meets; nanoflann cannot hold them.
IndexPeer MakeXTreePeer(const IndexData& data);
IndexPeer MakeBoostPacked(const IndexData& data);
IndexPeer MakeBoostRStar(const IndexData& data);  // point by point
IndexPeer MakeNanoflann(const IndexData& data);
IndexPeer MakeLibspatialindex(const IndexData& data);  // R*, bulk loaded (STR)
IndexPeer MakeEigenScan(const IndexData& data);

// Dimensions the peers are compiled for.
bool IsComparedDimension(int dimensions);

}  // namespace horopter
