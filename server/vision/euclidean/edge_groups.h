// Edge residuals as the covariance takes them: edge by edge, as what a lens or a rounded edge does
// is common to an edge.
#pragma once

#include <vector>

#include "server/vision/euclidean/scene_bundle.h"

namespace horopter {

// The points of one edge in one view, linearised; the line through their residuals along the edge.
struct EdgeGroup {
  int view = -1;
  int object = -1;
  int edge = -1;
  struct Point {
    EdgeRow row;
    double weight = 0.0;    // robust
    double residual = 0.0;  // working pixels
    double unit = 0.0;      // sigmas per working pixel
    double shared = 1.0;    // neighbours that count as one with it
    double at = 0.0;        // along the edge, -1 .. 1
  };
  std::vector<Point> points;
  double mean = 0.0, tilt = 0.0;
};

// By view, object and edge. Of round parts the rows forget turns about their axes. Points behind
// their cameras are left out.
std::vector<EdgeGroup> GroupEdges(const SceneBundle& bundle);

}  // namespace horopter
