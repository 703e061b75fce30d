// A part's mesh as the software renderer wants it: cleaned, welded, decimated to what a rendering
// of a few hundred pixels shows, with smooth normals and the adjacency that contours need.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

struct RenderMeshOptions {
  // Largest deviation of the decimated surface from the mesh, as a share of the diameter: 0.13 px
  // in a rendering of 200 px. Raising it gives fewer triangles.
  double tolerance = 1.0 / 1500.0;
  // Beyond this many triangles the deviation may grow to `coarse_tolerance`.
  int max_triangles = 6000;
  double coarse_tolerance = 1.0 / 300.0;
  // Facets that meet at a smaller angle are pieces of one smooth surface: a cylinder of twelve
  // facets is round, a prism of eight is not.
  double smooth_angle_rad = 0.54;
};

inline constexpr double kSharpTurnRad = 0.2615;  // 15 degrees

// An edge of the mesh between triangles `left` and `right`.
struct RenderMeshEdge {
  std::int32_t a = 0;  // vertices
  std::int32_t b = 0;
  std::int32_t left = -1;
  std::int32_t right = -1;    // -1: an open border, or more than two triangles meet
  bool same_winding = false;  // both triangles run through it in one direction: one is inside out
};

// An edge between two triangles whose normals differ much.
struct SharpEdge {
  RenderMeshEdge edge;
  float turn_rad = 0.0f;
};

// Vertices lie on a grid of 2^16 steps over the largest side of the bounding box, so that the mesh
// survives a blob (aspect_blob.h) bit for bit. Laws: indices in range, three vertices a triangle,
// no two triangles over the same ones. A sliver may have no area; its normals are zero.
struct RenderMesh {
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();  // of that grid, and its step: a vertex is
  float step_m = 0.0f;                               // origin + step_m * whole numbers
  std::vector<Eigen::Vector3f> vertices;             // metres, object frame
  std::vector<Eigen::Vector3i> triangles;  // counter-clockwise seen from outside, if `closed`
  std::vector<std::array<Eigen::Vector3f, 3>> normals;  // unit, of each triangle's corners
  std::vector<Eigen::Vector3f> face_normals;            // unit
  std::vector<char> flat;  // of triangles: the corners' normals are the face's
  std::vector<RenderMeshEdge> edges;
  std::vector<SharpEdge> sharp_edges;  // of them those that turn by more than kSharpTurnRad
  // No border, and the triangles agree which side is outside: back faces are never seen. Otherwise
  // both faces of a triangle are drawn.
  bool closed = false;
  double diameter_m = 0.0;                           // as of the model, > 0
  Eigen::Vector3f center = Eigen::Vector3f::Zero();  // of the bounding box
};

// Two million triangles are clustered before they are decimated, so that time is bounded (some
// seconds). `diameter_m` <= 0: taken from the bounding box. Errors: INVALID_ARGUMENT (an index out
// of range, a coordinate that is not finite, no triangle of positive area).
absl::StatusOr<RenderMesh> MakeRenderMesh(const TriangleMesh& mesh,
                                          double diameter_m = 0.0,
                                          const RenderMeshOptions& options = {});

// A vertex from its place on the grid, in whole steps.
inline Eigen::Vector3f GridPoint(const RenderMesh& mesh, const Eigen::Vector3f& steps) {
  return mesh.origin + mesh.step_m * steps;
}

// Fills what follows from vertices and triangles: normals, edges, `closed`, `center`. Triangles of
// a closed mesh that is inside out are turned.
void ConnectRenderMesh(double smooth_angle_rad, RenderMesh* mesh);

}  // namespace horopter
