// STEP and IGES through OpenCASCADE: exact edges and vertices of the boundary representation.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cad_import.h"

namespace horopter {

// Fills vertices, edges (unmerged), mesh, unit and warnings; see ImportCad for the rest and for the
// errors.
absl::StatusOr<CadImport> ImportBrep(const std::string& path,
                                     bool iges,
                                     const CadImportOptions& options);

// One import per different solid of the file, in the order of the file, each in the assembly's
// frame; a solid that is placed several times comes once, in its first place, with a warning that
// counts.
absl::StatusOr<std::vector<CadImport>> ImportBrepSolids(const std::string& path,
                                                        bool iges,
                                                        const CadImportOptions& options);

}  // namespace horopter
