// STEP and IGES files as OpenCASCADE reads them. The shape is in millimetres.
#pragma once

#include <TopoDS_Shape.hxx>
#include <TopoDS_TShape.hxx>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cad_import.h"

namespace horopter {

// What a file says of its bodies beside their geometry.
struct Annotations {
  std::vector<std::string> names;               // of the solids in the order of TopExp_Explorer
  std::map<const TopoDS_TShape*, Rgba> colors;  // of faces, solids and assemblies, wherever placed
};

// INVALID_ARGUMENT for a file that is cut short: it is often read without complaint, as the part it
// no longer is.
absl::Status CheckComplete(const std::string& path, bool iges);

// The shape, null where the file holds none; its unit and warnings go to `import`. What OpenCASCADE
// throws is passed on. Errors: INVALID_ARGUMENT (cannot be read).
absl::StatusOr<TopoDS_Shape> ReadStep(const std::string& path,
                                      CadImport& import,
                                      Annotations& annotations);
absl::StatusOr<TopoDS_Shape> ReadIges(const std::string& path, CadImport& import);

}  // namespace horopter
