#include "server/vision/recognition/aspect_search/object_layers.h"

#include <algorithm>
#include <cmath>

namespace horopter {

bool IsCovered(std::span<const ObjectLayer* const> others, int x, int y, float inverse_depth) {
  return std::any_of(others.begin(), others.end(), [&](const ObjectLayer* o) {
    return o->Has(x, y) && o->inverse_depth[o->Cell(x, y)] > inverse_depth;
  });
}

bool IsEdgeOf(std::span<const ObjectLayer* const> others, int x, int y, int bin) {
  return std::any_of(others.begin(), others.end(), [&](const ObjectLayer* o) {
    if (!o->Has(x, y)) return false;
    const int there = o->edge_bin[o->Cell(x, y)];
    if (there == ObjectLayer::kNoEdge) return false;
    const int apart = std::abs(bin - there);
    return std::min(apart, kAspectBins - apart) <= 1;
  });
}

}  // namespace horopter
