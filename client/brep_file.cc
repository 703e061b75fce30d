#include "client/brep_file.h"

#include <BRepBndLib.hxx>
#include <BRepBuilderAPI_Sewing.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <Bnd_Box.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Compound.hxx>
#include <TopoDS_Iterator.hxx>
#include <algorithm>
#include <cmath>

#include "absl/strings/ascii.h"

namespace horopter {
namespace {

// Whether some edge of the faces has one side only.
bool HasBorders(const TopoDS_Shape& faces) {
  TopTools_IndexedDataMapOfShapeListOfShape sides;
  TopExp::MapShapesAndAncestors(faces, TopAbs_EDGE, TopAbs_FACE, sides);
  for (int i = 1; i <= sides.Extent(); ++i) {
    const TopoDS_Edge& edge = TopoDS::Edge(sides.FindKey(i));
    if (BRep_Tool::Degenerated(edge) || sides(i).Extent() != 1) continue;
    if (!BRep_Tool::IsClosed(edge, TopoDS::Face(sides(i).First()))) return true;
  }
  return false;
}

// Of each face its own colour, else that of what it belongs to.
void ColorsOfFaces(const TopoDS_Shape& shape,
                   const std::map<const TopoDS_TShape*, Rgba>& colors,
                   Rgba inherited,
                   std::map<const TopoDS_TShape*, Rgba>* out) {
  const auto own = colors.find(shape.TShape().get());
  if (own != colors.end()) inherited = own->second;
  if (shape.ShapeType() == TopAbs_FACE) {
    if (inherited != kNoColor) (*out)[shape.TShape().get()] = inherited;
    return;
  }
  for (TopoDS_Iterator it(shape); it.More(); it.Next()) {
    if (it.Value().ShapeType() <= TopAbs_FACE) {
      ColorsOfFaces(it.Value(), colors, inherited, out);
    }
  }
}

}  // namespace

void SetUnit(const std::string& word, double metres, CadImport* import) {
  import->unit_name = absl::AsciiStrToLower(word);
  import->metres_per_unit = metres;
  import->unit_from_file = true;
  constexpr double kSame = 1e-6;
  for (const char* unit : {"mm", "cm", "m", "in", "ft", "um", "mil", "km"}) {
    if (std::abs(MetresPerUnit(unit) / metres - 1.0) < kSame) {
      import->unit_name = unit;
      import->metres_per_unit = MetresPerUnit(unit);
    }
  }
}

TopoDS_Shape WithoutBodies(const TopoDS_Shape& shape,
                           const std::set<const TopoDS_TShape*>& bodies) {
  if (shape.IsNull() || bodies.contains(shape.TShape().get())) return {};
  if (shape.ShapeType() != TopAbs_COMPOUND) return shape;
  TopoDS_Compound kept;
  BRep_Builder builder;
  builder.MakeCompound(kept);
  bool changed = false;
  // The children as they are in the compound; its own place is set afterwards.
  for (TopoDS_Iterator it(shape, false, false); it.More(); it.Next()) {
    const TopoDS_Shape child = WithoutBodies(it.Value(), bodies);
    changed = changed || child.IsNull() || !child.IsSame(it.Value());
    if (!child.IsNull()) builder.Add(kept, child);
  }
  if (!changed) return shape;
  kept.Location(shape.Location());
  kept.Orientation(shape.Orientation());
  return kept;
}

int MostWires(const TopoDS_Shape& shape) {
  int most = 0;
  for (TopExp_Explorer face(shape, TopAbs_FACE); face.More(); face.Next()) {
    int wires = 0;
    for (TopExp_Explorer wire(face.Current(), TopAbs_WIRE); wire.More(); wire.Next()) ++wires;
    most = std::max(most, wires);
  }
  return most;
}

TopoDS_Shape Sewn(const TopoDS_Shape& shape, Annotations* annotations) {
  if (shape.IsNull()) return shape;
  BRep_Builder builder;
  TopoDS_Compound loose, sewn;
  builder.MakeCompound(loose);
  builder.MakeCompound(sewn);
  bool any = false;
  for (TopExp_Explorer it(shape, TopAbs_FACE, TopAbs_SOLID); it.More(); it.Next()) {
    builder.Add(loose, it.Current());
    any = true;
  }
  if (!any || !HasBorders(loose)) return shape;
  Bnd_Box box;
  BRepBndLib::Add(loose, box, false);
  // Gaps between faces of one part; files of old systems hold five digits.
  constexpr double kShare = 1e-4, kWidestMm = 0.02;
  const double gap_mm = std::min(kWidestMm, kShare * std::sqrt(box.SquareExtent()));
  BRepBuilderAPI_Sewing sewing(gap_mm);
  for (TopExp_Explorer it(loose, TopAbs_FACE); it.More(); it.Next()) sewing.Add(it.Current());
  sewing.Perform();
  if (sewing.SewedShape().IsNull()) return shape;
  for (TopExp_Explorer it(shape, TopAbs_SOLID); it.More(); it.Next()) {
    builder.Add(sewn, it.Current());
  }
  builder.Add(sewn, sewing.SewedShape());
  std::map<const TopoDS_TShape*, Rgba> of_faces;
  ColorsOfFaces(shape, annotations->colors, kNoColor, &of_faces);
  for (TopExp_Explorer it(loose, TopAbs_FACE); it.More(); it.Next()) {
    const auto color = of_faces.find(it.Current().TShape().get());
    if (color == of_faces.end()) continue;
    const TopoDS_Shape now = sewing.Modified(it.Current());
    if (!now.IsNull()) annotations->colors[now.TShape().get()] = color->second;
  }
  return sewn;
}

}  // namespace horopter
