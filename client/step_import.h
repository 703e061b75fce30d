// STEP and IGES through OpenCASCADE: exact edges and vertices of the boundary representation.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "client/cad_import.h"

namespace horopter {

// Fills vertices, edges (unmerged), mesh, unit and warnings; see ImportCad for the rest and for the
// errors.
absl::StatusOr<CadImport> ImportBrep(const std::string& path,
                                     bool iges,
                                     const CadImportOptions& options);

}  // namespace horopter
