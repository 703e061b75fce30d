// Triangle soup -> welded, consistently oriented mesh with edge adjacency.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// 1 degree: two triangles whose planes differ by less are of one face.
inline constexpr double kCoplanarRad = 0.0175;

// Result of cleaning a triangle soup.
struct CleanMesh {
  TriangleMesh mesh;
  int degenerate_triangles = 0;  // dropped
  int split_triangles = 0;       // T-junctions repaired
  int duplicate_triangles = 0;   // over the same vertices as another; dropped
  int turned_triangles = 0;      // pointed the other way than the rest, or inwards
  bool closed = true;            // every edge has two triangles
};

// Welds vertices closer than `weld_distance`, drops degenerate triangles, splits triangles whose
// edge carries another open edge's vertex, orients the triangles consistently and, where a shell is
// closed, outward; a shell inside another one stays as most of it is (a cavity). Colours stay with
// their triangles.
CleanMesh CleanTriangleSoup(const TriangleMesh& soup, double weld_distance);

// An edge of the mesh with its triangles; `dihedral_rad` is the angle of their normals, pi at an
// open border.
struct MeshEdge {
  int a = -1;  // a < b, vertex indices
  int b = -1;
  int triangle_1 = -1;
  int triangle_2 = -1;  // -1 at an open border; of more than two triangles the first two are kept
  double dihedral_rad = 0.0;
  int triangles = 0;  // that meet there
};

std::vector<MeshEdge> MeshEdges(const TriangleMesh& mesh);

// Region of every triangle, named by one of its triangles: triangles are joined over the edges that
// `joins` accepts of those with two of them.
std::vector<int> TriangleRegions(std::size_t triangles,
                                 const std::vector<MeshEdge>& edges,
                                 const std::function<bool(const MeshEdge&)>& joins);

// Unit normal of every triangle.
std::vector<Eigen::Vector3d> TriangleNormals(const TriangleMesh& mesh);

}  // namespace horopter
