// Edges of a patterned surface: families of straight lines through one vanishing point (stripes,
// planks, grids) or many small closed curves (perforated sheet) that cover the image. They break
// the contours of what lies before them and are no part's.
#pragma once

#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

struct PatternOptions {
  // Of the image's area, in blocks, that a pattern runs over: less may be a part's own ribs or
  // holes.
  double min_coverage = 0.5;
  bool dots = true;  // closed curves make a pattern, too
};

// For each edge point of the raster whether it belongs to a pattern; empty when there is none.
// `contours` are those of the raster, `texture` places of edges that were dropped before.
// Deterministic.
std::vector<std::uint8_t> FindPatternPoints(const PointRaster& raster,
                                            const ContourGraph& contours,
                                            const std::vector<Eigen::Vector2f>& texture = {},
                                            const PatternOptions& options = {});

}  // namespace horopter
