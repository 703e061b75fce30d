// Contours that run through corners: runs of edge points, and where each can go on.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace horopter {

// Where a contour can go on from the end of a chain: to an end of a chain (its own other one when
// closed).
struct ChainLink {
  int chain = -1;
  bool at_front = false;  // enters there and walks towards the back
  float gap_px = 0.0f;
};

// A maximal run of edge points between ends and junctions, and what its ends are linked to.
struct ContourChain {
  int begin = 0;  // of ContourGraph::points
  int size = 0;
  std::vector<ChainLink> after_front, after_back;  // best first, at most 3
};

struct ContourGraph {
  std::vector<Eigen::Vector2f> points;
  std::vector<ContourChain> chains;
};

// Points of width x height cells, at most one a cell (that of its rounded coordinates).
struct PointRaster {
  int width = 0;
  int height = 0;
  std::vector<Eigen::Vector2f> points;
  std::vector<std::int32_t> at;  // [cell], index into points, -1: none
};

// Points outside are dropped; of several in one cell the first is kept.
PointRaster MakePointRaster(int width, int height, const std::vector<Eigen::Vector2f>& points);

// Runs of 8-connected points, split where another run ends on them, their ends linked over gaps of
// at most max_gap_px, whatever the contrast: a contour in front of stripes changes its sign.
ContourGraph TraceContours(const PointRaster& raster, double max_gap_px);

}  // namespace horopter
