// What an importer says about a part beside its geometry: what is odd and what recognition cannot
// tell of it.
#pragma once

#include <Eigen/Core>
#include <string>

#include "client/cad_import.h"
#include "server/vision/geometry/mesh_symmetry.h"

namespace horopter {

// Adds a finding; unless it is a mere note also to the warnings.
void AddFinding(CadFindingKind kind, std::string text, CadImport* import);

// Fills `symmetries` and finds what shows in the finished mesh: borders, bodies and cavities, no
// edges, no orientation, plain plates, near symmetries, a unit that is not likely.
void FindOddities(const MeshSymmetryOptions& options, CadImport* import);

// "; it would be 58.4 mm with --units in", or nothing where no unit gives a likely size.
std::string SuggestUnits(const CadImport& import);

// "turned by 90 degrees about the axis (0.00, 0.00, 1.00) it is the same but for 4.2 mm at (12.0,
// 3.1, 0.0) mm, off by 1.5 mm".
std::string Describe(const NearSymmetry& near);

// Of a rotation that a file declares and the surface does not have.
std::string DescribeMismatch(const Rigid3& declared, const SurfaceMismatch& mismatch);

}  // namespace horopter
