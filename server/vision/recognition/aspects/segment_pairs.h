// Pairs of adjacent straight pieces of contours: corners as blocks show them, with a size. A piece
// of contour about one corner alone has none (contour_fragments.h). After the k-adjacent segments
// of Ferrari, Fevrier, Jurie, Schmid 2008.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

// Two arms that leave a corner. Turning arm a by `opening_rad`, from x towards y, gives arm b.
// Laws: opening and the lengths' ratio are unchanged by similarities; a mirror image swaps the
// arms.
struct SegmentPair {
  Eigen::Vector2f corner = Eigen::Vector2f::Zero();
  float direction_rad = 0.0f;  // of arm a
  float opening_rad = 0.0f;    // in (0, pi)
  float length_a = 0.0f, length_b = 0.0f;
};

struct SegmentPairOptions {
  double min_length = 12.0;  // of an arm, in the unit of the points
  double max_offset = 1.2;   // of a point from its straight piece
  double max_gap = 6.0;      // between ends that meet in a corner or go on in line
  int max_pairs = 400;       // those with the longest shorter arms are kept
};

// Pieces that go on in line over gaps and junctions are one arm. Longest first.
std::vector<SegmentPair> CollectSegmentPairs(const ContourGraph& graph,
                                             const SegmentPairOptions& options = {});

}  // namespace horopter
