// Edges of a patterned surface: families of straight lines through one vanishing point (stripes,
// planks, grids) or many small closed curves (perforated sheet) that cover the image. They break
// the contours of what lies before them and are no part's.
#pragma once

#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

struct PatternOptions {
  double min_length_share = 0.045;  // of the image's width: straight pieces that make a family
  double max_bend_px = 1.4;         // of a straight piece from its chord
  double max_angle_rad = 0.026;     // between a piece and the direction of the vanishing point
  // Of the image's area, in blocks, that a pattern runs over: less may be a part's own ribs or
  // holes.
  double min_coverage = 0.5;
  // ... of it by the pattern itself: where its far end is so fine that it was dropped as texture,
  // that counts as well.
  double min_own_coverage = 0.08;
  int min_pieces = 24;
  int max_families = 2;  // a grid has two
  // Closed curves that make a pattern: how many, their shortest and longest perimeters as shares of
  // the width, and their least area as a share of a circle's of the same perimeter. The holes of a
  // lattice may be small; what is strewn and so small are speckles, which are told by texture.
  int min_dots = 40;
  double min_dot_share = 0.035;
  double min_lattice_share = 0.016;
  double max_dot_share = 0.25;
  double min_roundness = 0.35;
};

// For each edge point of the raster whether it belongs to a pattern; empty when there is none.
// `contours` are those of the raster, `texture` places of edges that were dropped before.
// Deterministic.
std::vector<std::uint8_t> FindPatternPoints(const PointRaster& raster,
                                            const ContourGraph& contours,
                                            const std::vector<Eigen::Vector2f>& texture = {},
                                            const PatternOptions& options = {});

}  // namespace horopter
