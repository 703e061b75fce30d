// Straight edges between points, and the plane faces they bound.
#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

struct Wireframe {
  std::vector<Eigen::Vector3d> points;
  std::vector<std::pair<int, int>> edges;  // indices of different points, each pair once
};

struct WireframeSurface {
  TriangleMesh mesh;   // not oriented
  int faces = 0;       // plane regions, with holes
  int open_edges = 0;  // that do not bound exactly two faces
};

// Faces are the closed loops of edges in one plane; a loop inside another one is its hole, one
// inside a hole a face again. Points within `tolerance` of a plane are in it. A wireframe of a
// polyhedron gives its surface, except where several polyhedra have the same edges.
WireframeSurface SurfaceOfWireframe(const Wireframe& wireframe, double tolerance);

}  // namespace horopter
