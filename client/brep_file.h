// STEP and IGES files as OpenCASCADE reads them. The shape is in millimetres.
#pragma once

#include <TopoDS_Shape.hxx>
#include <TopoDS_TShape.hxx>
#include <map>
#include <set>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cad_import.h"

namespace horopter {

// What a file says of its bodies beside their geometry.
struct Annotations {
  std::map<const TopoDS_TShape*, std::string> names;  // of the products of solids
  std::string root_name;                              // of the product that holds all others
  std::map<const TopoDS_TShape*, Rgba> colors;  // of faces, solids and assemblies, wherever placed
  TriangleMesh tessellated;                     // metres; of a file that holds nothing exact
};

// The shape, null where the file holds none that is exact; its unit and warnings go to `import`.
// STEP may be packed with gzip. Faces that hang together with no others are sewn; hidden bodies are
// left out and told. What OpenCASCADE throws is passed on. Errors: NOT_FOUND, INVALID_ARGUMENT
// (cannot be read, cut short, a body that is lost, parts in other files; with entity and name).
absl::StatusOr<TopoDS_Shape> ReadStep(const std::string& path,
                                      CadImport& import,
                                      Annotations& annotations);
absl::StatusOr<TopoDS_Shape> ReadIges(const std::string& path, CadImport& import);

// Of a unit by its factor: its short name, else the file's word.
void SetUnit(const std::string& word, double metres, CadImport* import);

// The shape without the bodies that are one of these, wherever they are placed.
TopoDS_Shape WithoutBodies(const TopoDS_Shape& shape, const std::set<const TopoDS_TShape*>& bodies);

// The shape with those faces sewn that belong to no solid, where their borders meet; colours follow
// them.
TopoDS_Shape Sewn(const TopoDS_Shape& shape, Annotations* annotations);

// The most closed borders that one of its faces has: its outer one and one of each hole.
int MostWires(const TopoDS_Shape& shape);

}  // namespace horopter
