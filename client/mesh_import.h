// PLY, STL, OBJ, CAO, clouds and reconstructions: welded mesh, sharp edges by dihedral angle,
// circles found again in polygonal rims.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "client/cad_import.h"

namespace horopter {

// Fills vertices, edges, mesh, unit and warnings; see ImportCad for the rest and for the errors.
absl::StatusOr<CadImport> ImportMesh(const std::string& path, const CadImportOptions& options);

// Fills vertices, edges and mesh from triangles in metres; told_faces: they say which side is
// outside. Errors: INVALID_ARGUMENT naming the path (all degenerate).
absl::Status FillFromTriangles(const std::string& path,
                               const TriangleMesh& triangles,
                               bool told_faces,
                               const CadImportOptions& options,
                               CadImport* import);

}  // namespace horopter
