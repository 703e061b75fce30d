// PLY, STL, OBJ, CAO, clouds and reconstructions: welded mesh, sharp edges by dihedral angle,
// circles found again in polygonal rims.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "client/cad_import.h"

namespace horopter {

// Fills vertices, edges, mesh, unit and warnings; see ImportCad for the rest and for the errors.
absl::StatusOr<CadImport> ImportMesh(const std::string& path, const CadImportOptions& options);

}  // namespace horopter
