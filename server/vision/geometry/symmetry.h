// The rotations that leave a part unchanged, found from its geometry.
#pragma once

#include <vector>

#include "server/vision/geometry/mesh_symmetry.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

struct SymmetryOptions {
  // Largest deviation of vertices, as a share of the diameter; curves and mesh, which are sampled,
  // may deviate twice as far. Raising it calls nearly symmetric parts symmetric.
  double tolerance = 1e-3;
  int max_order = 60;         // of the group; more elements than this are cut off (icosahedral: 60)
  int revolution_steps = 36;  // a surface of revolution is listed as this many rotations
};

// All proper rotations x -> S x of the part onto itself except the identity, each about an axis
// through its centroid; mirror images are no rotations. Uses vertices, edges, mesh and diameter_m
// (> 0) of the model, not `symmetries`.
//
// Method: two anchors (vertices, centres of closed circles) not collinear with the centroid fix a
// rotation; every pair with the same three distances gives a candidate, which is verified on
// anchors, edges and mesh. Parts whose anchors all lie on one axis are tested as surfaces of
// revolution. If the surface alone has more of them (mesh_symmetry.h), those are taken; of a sphere
// the rotations of an icosahedron.
std::vector<Rigid3> DeriveSymmetries(const ObjectModel& model, const SymmetryOptions& options = {});

// The same, given what FindMeshSymmetries found with OfSurface(options).
MeshSymmetryOptions OfSurface(const SymmetryOptions& options);
std::vector<Rigid3> DeriveSymmetries(const ObjectModel& model,
                                     const SymmetryOptions& options,
                                     const MeshSymmetries& of_surface);

// How two lists of a part's rotations, without the identity, differ: as a file declares them and as
// the geometry has them.
struct SymmetryDifference {
  int only_declared = 0;
  int only_derived = 0;
};

// Rotations are the same when no point of the part is moved differently by more than `tolerance`
// diameters.
SymmetryDifference CompareSymmetries(const std::vector<Rigid3>& declared,
                                     const std::vector<Rigid3>& derived,
                                     const ObjectModel& model,
                                     double tolerance = 0.01);

}  // namespace horopter
