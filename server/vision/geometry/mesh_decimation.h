// Fewer triangles for nearly the same surface. Garland & Heckbert 1997: surface simplification
// using quadric error metrics.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace horopter {

struct IndexedMesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
};

struct DecimationLimits {
  double tolerance = 0.0;  // a vertex moves by less off the planes it stands for; units of the mesh
  int max_triangles = 0;   // beyond this many ...
  double coarse_tolerance = 0.0;  // ... it may move by this
};

// Vertices that share a cell of a grid become one, where the planes of their triangles meet best
// (Lindstrom 2000); triangles that collapse are dropped. At least one vertex.
IndexedMesh ClusterVertices(const IndexedMesh& mesh, double cell);

// Collapses edges, cheapest first. Keeps open borders in place, keeps the topology of what is
// manifold and never turns a triangle over. Vertices that no triangle uses are dropped.
IndexedMesh Decimate(IndexedMesh mesh, const DecimationLimits& limits);

}  // namespace horopter
