// CAD file -> ObjectModel: vertices, sharp edges, mesh, symmetries and diameter, in metres.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/mesh_symmetry.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

struct CadImportOptions {
  // Unit of a file that does not name one (PLY, STL, OBJ, GLB, CAO): mm, cm, m, in, ft or um.
  // Empty: mm, of GLB and CAO m. STEP, IGES and 3MF carry their unit; naming a different one here
  // is an error, not an override.
  std::string unit;
  // An edge is sharp when the outward normals of its two faces differ by at least this angle (15
  // degrees). Raising it drops chamfer and draft edges; lowering it turns the facets of coarse
  // round surfaces into edges.
  double sharp_angle_rad = 0.2617993877991494;
  double max_chord_error =
      1e-3;  // of mesh and curves, as a share of the diameter; raising: coarser curves
  // Largest deviation that still counts as symmetric, as a share of the diameter. Raising it calls
  // nearly symmetric parts symmetric.
  double symmetry_tolerance = 1e-3;
  // A mesh of more triangles is simplified on a grid of 1 / 250 of the diameter before anything
  // else; its sharp edges stay.
  int max_triangles = 300000;
};

// What is odd about a file though it can be used.
enum class CadFindingKind {
  kOther = 0,
  kOpenMesh,         // the surface has borders
  kInvertedFaces,    // faces that pointed inwards were turned
  kDuplicateFaces,   // faces that were there twice were dropped
  kSimplified,       // too many triangles; fewer stand for them
  kScan,             // noisy: of its edges those on creases of the part were kept
  kSeveralBodies,    // an assembly, taken as one rigid part
  kHiddenInside,     // shells that nobody sees from outside
  kNoSharpEdges,     // found by its aspects alone
  kNoOrientation,    // a sphere
  kPlainPlate,       // thin and the same from both sides
  kNearlySymmetric,  // but for small features
  kDoubtfulUnit,     // another unit would give a likelier size
};

struct CadFinding {
  CadFindingKind kind = CadFindingKind::kOther;
  std::string text;
};

struct CadImport {
  ObjectModel model;           // id, display_name and grasps are left empty
  std::string name;            // of the product, as the file calls it; often empty
  std::string format;          // STEP, IGES, PLY, STL, OBJ, GLB, 3MF, CAO or JSON
  std::string unit_name;       // mm, cm, m, in, ft, um, or the file's own word for an unusual unit
  double metres_per_unit = 0;  // of unit_name
  bool unit_from_file = false;
  std::vector<std::string> warnings;
  std::vector<CadFinding> findings;  // those of the warnings that have a kind, and mere notes
  MeshSymmetries symmetries;  // of the surface: exact ones, and near ones with what breaks them
  std::map<std::string, int>
      counts;  // vertices, lines, circles, other_curves, triangles, symmetries
};

// Metres in one unit (mm, cm, m, in, ft, um and their long names, any case), or 0 for an unknown
// word.
double MetresPerUnit(const std::string& unit);

// Reads a CAD file by its extension (.step .stp .stpz .step.gz .iges .igs .ply .stl .obj .glb .3mf
// .cao), a calibrated reconstruction (.json, client/reconstruction_file.h) or a point cloud (.ply
// without faces: plane faces only).
// Circles come as one kCircle edge each (closed ones without vertices); seam vertices and the
// vertices of tessellated rims are no part corners; collinear pieces are one edge. The mesh is
// welded and oriented outward. Errors: NOT_FOUND (no such file), INVALID_ARGUMENT naming the file
// (empty, truncated, not CAD, non-finite coordinates, diameter outside 1 mm .. 10 m, unknown or
// contradicting unit). Not thread-safe for STEP and IGES: OpenCASCADE keeps global
// state while it reads.
absl::StatusOr<CadImport> ImportCad(const std::string& path, const CadImportOptions& options = {});

// An assembly split into its different solids (STEP and IGES; other formats give one part). Errors:
// as ImportCad, for the first solid that cannot be used.
absl::StatusOr<std::vector<CadImport>> ImportCadParts(const std::string& path,
                                                      const CadImportOptions& options = {});

}  // namespace horopter
