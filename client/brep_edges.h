// Edges of an OpenCASCADE shape that an image can show.
#pragma once

#include <Eigen/Core>
#include <TopoDS_Shape.hxx>
#include <gp_Pnt.hxx>

#include "client/cad_import.h"

namespace horopter {

// OpenCASCADE hands everything out in mm.
Eigen::Vector3d Metres(const gp_Pnt& p);

// Adds the shape's edges (millimetres) to the model in metres: sharp ones with their dihedral,
// curves sampled within chord_error_mm.
void ExtractEdges(const TopoDS_Shape& shape,
                  const CadImportOptions& options,
                  double chord_error_mm,
                  CadImport& import);

}  // namespace horopter
