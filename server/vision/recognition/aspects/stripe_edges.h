// Edges of a striped surface: families of straight lines through one vanishing point that cover the
// image. They break the contours of what lies before them and are no part's.
#pragma once

#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

struct StripeOptions {
  double min_length_share = 0.045;  // of the image's width: straight pieces that make a family
  double max_bend_px = 1.4;         // of a straight piece from its chord
  double max_angle_rad = 0.026;     // between a piece and the direction of the vanishing point
  // Of the image's area, in blocks, that a family runs over: less may be a part's own ribs.
  double min_coverage = 0.5;
  int min_pieces = 24;
  int max_families = 2;  // a grid has two
};

// For each edge point of the raster whether it lies on a stripe; empty when there are none.
// `contours` are those of the raster. Deterministic.
std::vector<std::uint8_t> FindStripePoints(const PointRaster& raster,
                                           const ContourGraph& contours,
                                           const StripeOptions& options = {});

}  // namespace horopter
