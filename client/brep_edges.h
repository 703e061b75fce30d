// Edges of an OpenCASCADE shape that an image can show.
#pragma once

#include <TopoDS_Shape.hxx>

#include "client/cad_import.h"

namespace horopter {

// Adds the shape's edges (millimetres) to the model in metres: sharp ones with their dihedral,
// curves sampled within chord_error_mm.
void ExtractEdges(const TopoDS_Shape& shape,
                  const CadImportOptions& options,
                  double chord_error_mm,
                  CadImport& import);

}  // namespace horopter
