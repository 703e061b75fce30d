// Rotations that take a surface onto itself, or onto itself but for small features: found from the
// mesh alone, whatever its edges are.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

struct SymmetryAxis {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  // unit, object frame
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // on it, metres
  int order = 1;                                    // turns by 2 pi / order; 0: by any angle
};

// How a surface and its moved self differ. Distances are from the moved surface to the surface, at
// most MeshSymmetryOptions::reach diameters.
struct SurfaceMismatch {
  double largest_m = 0.0;
  double mean_m = 0.0;      // over the area
  double area_share = 0.0;  // 0..1, of what is off by more than the tolerance
  // Of the largest region without a counterpart, before the motion: its middle and its extent.
  Eigen::Vector3d place = Eigen::Vector3d::Zero();
  double size_m = 0.0;
};

// A turn that images may not tell from the identity: the part is symmetric but for what `mismatch`
// names.
struct NearSymmetry {
  SymmetryAxis axis;
  SurfaceMismatch mismatch;
};

struct MeshSymmetries {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();  // of the surface's area
  std::vector<SymmetryAxis> exact;                   // generate the group
  std::vector<NearSymmetry> near;                    // least mean mismatch first
  bool sphere = false;                               // no orientation at all
};

struct MeshSymmetryOptions {
  // Largest deviation, in diameters, that is still none: chords of tessellated circles.
  double tolerance = 2e-3;
  // Mean deviation, in diameters, up to which a turn is a near symmetry. Raising it lists turns
  // that images tell apart.
  double near_mean = 8e-3;
  double reach = 0.05;  // diameters; farther counts as this
  int max_order = 120;  // of an axis
  int max_near = 8;     // kept
};

// Axes through the area's centroid: of the frame, the principal ones and those of the largest plane
// faces, and around each that is one the half turns perpendicular to it. Near ones are moved to
// where they fit best. 50 - 200 ms. Deterministic; empty for a mesh without area.
MeshSymmetries FindMeshSymmetries(const TriangleMesh& mesh,
                                  double diameter_m,
                                  const MeshSymmetryOptions& options = {});

// Of each motion.
std::vector<SurfaceMismatch> MeasureMismatches(const TriangleMesh& mesh,
                                               double diameter_m,
                                               std::span<const Rigid3> motions,
                                               const MeshSymmetryOptions& options = {});

// A turn about an axis.
Rigid3 TurnAbout(const SymmetryAxis& axis, double angle_rad);

// The turns of an axis but the identity; of one of order 0, `steps` evenly spaced ones stand for
// all.
std::vector<Rigid3> TurnsOf(const SymmetryAxis& axis, int steps = 36);

// The group that the exact axes generate, without the identity, all about the centre: at most
// `most`. Of a sphere the rotations of an icosahedron stand for all.
std::vector<Rigid3> SymmetryGroup(const MeshSymmetries& symmetries, int steps = 36, int most = 240);

}  // namespace horopter
