// A catalog object as every stage sees it: vertices, sharp edges, mesh, symmetries and grasps, in
// metres.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "server/vision/geometry/rigid3.h"
#include "server/vision/geometry/surface_print.h"

namespace horopter {

enum class CurveKind { kLine = 0, kCircle = 1, kOther = 2 };

// A sharp edge of the part. Invariants: polyline has >= 2 points, its ends equal the named
// vertices; a closed curve has start_vertex == end_vertex == -1 and repeats its first point at the
// end. Circles are sampled so that the chord error is at most 1 % of the radius.
struct ModelEdge {
  CurveKind kind = CurveKind::kLine;
  int start_vertex = -1;  // index into ObjectModel::vertices
  int end_vertex = -1;
  double dihedral_rad =
      0.0;  // angle between the outward normals of the two faces; 0 = smooth, pi/2 = cube edge
  std::vector<Eigen::Vector3d> polyline;
};

// Red, green, blue and opacity, 0..255, as displayed (sRGB).
using Rgba = std::array<std::uint8_t, 4>;

// What the CAD file gives no colour: opacity 0.
inline constexpr Rgba kNoColor{0, 0, 0, 0};

// Closed triangle mesh, counter-clockwise seen from outside.
struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
  std::vector<Rgba> colors;  // of the triangles, or empty: none is known
};

// Gripper frame: origin between the finger tips, z = approach direction (gripper to part), x =
// closing direction.
struct Grasp {
  std::string name;
  Rigid3 object_from_gripper;
  double jaw_opening_m = 0.0;  // opening before closing
  double grip_width_m = 0.0;   // distance of the gripped faces
  double quality = 1.0;        // 0..1, larger is better
  // Where the gripper waits, open, before it moves straight to the grasp. Unset: not given.
  std::optional<Rigid3> object_from_pregrasp = {};
};

// All geometry in the object's own frame, metres. `symmetries` lists every rotation of the discrete
// symmetry group except the identity (object_from_object: x -> S x leaves the part unchanged).
struct ObjectModel {
  std::string id;            // e.g. "obj_000001": [a-z0-9_-]{1,63}
  std::string display_name;  // free text
  std::vector<Eigen::Vector3d> vertices;
  std::vector<ModelEdge> edges;
  TriangleMesh mesh;
  std::vector<Rigid3> symmetries;
  std::vector<Grasp> grasps;
  double diameter_m = 0.0;  // largest distance between two mesh vertices
  SurfacePrint print = {};  // learnt where that was asked for
};

}  // namespace horopter
