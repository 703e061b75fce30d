#include "client/step_import.h"

#include <BRepBndLib.hxx>
#include <BRepBuilderAPI_Transform.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRep_Tool.hxx>
#include <Bnd_Box.hxx>
#include <Eigen/Geometry>
#include <IMeshTools_Parameters.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Message_PrinterOStream.hxx>
#include <Poly_Triangulation.hxx>
#include <Standard_Failure.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_IndexedMapOfShape.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Face.hxx>
#include <TopoDS_Iterator.hxx>
#include <algorithm>
#include <cmath>
#include <exception>
#include <gp_Trsf.hxx>
#include <iterator>
#include <map>

#include "absl/strings/str_cat.h"
#include "client/brep_edges.h"
#include "client/brep_file.h"
#include "client/cad_findings.h"
#include "client/edge_chains.h"
#include "client/mesh_import.h"
#include "client/mesh_topology.h"
#include "client/units.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Calls visit(face, colour) for every face: its own colour, else that of the body around it.
template <typename Visit>
void ForEachFace(const TopoDS_Shape& shape,
                 const std::map<const TopoDS_TShape*, Rgba>& colors,
                 Rgba inherited,
                 const Visit& visit) {
  const auto own = colors.find(shape.TShape().get());
  if (own != colors.end()) inherited = own->second;
  if (shape.ShapeType() == TopAbs_FACE) return visit(TopoDS::Face(shape), inherited);
  for (TopoDS_Iterator it(shape); it.More(); it.Next()) {
    if (it.Value().ShapeType() <= TopAbs_FACE) ForEachFace(it.Value(), colors, inherited, visit);
  }
}

TriangleMesh Triangulate(const TopoDS_Shape& shape,
                         const Annotations& annotations,
                         double chord_error_mm) {
  IMeshTools_Parameters parameters;
  parameters.Deflection = chord_error_mm;
  parameters.Angle = 0.35;  // 20 degrees: 18 facets of a hole at least
  // OpenCASCADE's own triangulation of a face takes the square of its holes: minutes for a
  // thousand.
  constexpr int kManyHoles = 100;  // a tenth of a second
  if (MostWires(shape) > kManyHoles) parameters.MeshAlgo = IMeshTools_MeshAlgoType_Delabella;
  BRepMesh_IncrementalMesh mesher(shape, parameters);
  TriangleMesh soup;
  ForEachFace(shape, annotations.colors, kNoColor, [&](const TopoDS_Face& face, const Rgba& color) {
    TopLoc_Location location;
    const Handle(Poly_Triangulation) part = BRep_Tool::Triangulation(face, location);
    if (part.IsNull()) return;
    const int offset = static_cast<int>(soup.vertices.size());
    for (int i = 1; i <= part->NbNodes(); ++i) {
      soup.vertices.push_back(Metres(part->Node(i).Transformed(location.Transformation())));
    }
    const bool reversed = face.Orientation() == TopAbs_REVERSED;
    for (int i = 1; i <= part->NbTriangles(); ++i) {
      int a = 0, b = 0, c = 0;
      part->Triangle(i).Get(a, b, c);
      if (reversed) std::swap(b, c);
      soup.triangles.push_back(Eigen::Vector3i(a - 1, b - 1, c - 1).array() + offset);
      soup.colors.push_back(color);
    }
  });
  return soup;
}

absl::Status ImportShape(const std::string& path,
                         const TopoDS_Shape& shape,
                         const Annotations& annotations,
                         const CadImportOptions& options,
                         CadImport& import) {
  if (!annotations.tessellated.triangles.empty()) {
    constexpr bool kToldFaces = true;  // their corners run round as seen from outside
    return FillFromTriangles(path, annotations.tessellated, kToldFaces, options, &import);
  }
  if (shape.IsNull() || !TopExp_Explorer(shape, TopAbs_FACE).More()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": holds no faces"));
  }
  TopTools_IndexedMapOfShape solids;
  TopExp::MapShapes(shape, TopAbs_SOLID, solids);
  if (solids.IsEmpty()) import.warnings.push_back("the file holds surfaces, no solid");
  if (solids.Extent() > 1) {
    AddFinding(CadFindingKind::kSeveralBodies,
               absl::StrCat("the file holds ",
                            solids.Extent(),
                            " solids; taken as one rigid part: loose ones do not belong in it"),
               &import);
  }
  Bnd_Box box;
  BRepBndLib::AddOptimal(shape, box, false, false);
  const double diagonal_mm = std::sqrt(box.SquareExtent());
  if (!std::isfinite(diagonal_mm) || box.IsOpen() || diagonal_mm <= 0.0) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": has no finite extent"));
  }
  const double chord_error_mm = options.max_chord_error * diagonal_mm;
  // Edges are compared with images: finer than the mesh, which only hides and shades.
  ExtractEdges(shape, options, 0.5 * chord_error_mm, import);
  constexpr double kWeldShare = 1e-6;  // triangulated faces share their border points
  CleanMesh clean = CleanTriangleSoup(Triangulate(shape, annotations, chord_error_mm),
                                      kWeldShare * kMetresPerMm * diagonal_mm);
  if (clean.mesh.triangles.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": cannot be triangulated"));
  }
  import.model.mesh = std::move(clean.mesh);
  MergeSmoothJoints(import.model, 1e-5 * kMetresPerMm * diagonal_mm);
  return absl::OkStatus();
}

// Of the part, where there is one; else of the product that holds all.
std::string NameOfWhole(const TopoDS_Shape& shape, const Annotations& annotations) {
  if (shape.IsNull()) return annotations.root_name;
  TopTools_IndexedMapOfShape solids;
  TopExp::MapShapes(shape, TopAbs_SOLID, solids);
  if (solids.Extent() == 1) {
    const auto name = annotations.names.find(solids(1).TShape().get());
    if (name != annotations.names.end()) return name->second;
  }
  return annotations.root_name;
}

// Reads the file and hands its shape to `use`; what OpenCASCADE throws becomes a status.
template <typename Result, typename Use>
absl::StatusOr<Result> WithShape(const std::string& path,
                                 bool iges,
                                 const CadImportOptions& options,
                                 const Use& use) {
  Message::DefaultMessenger()->RemovePrinters(STANDARD_TYPE(Message_PrinterOStream));
  CadImport import;
  Annotations annotations;
  try {
    HOROPTER_ASSIGN_OR_RETURN(TopoDS_Shape shape,
                              iges ? ReadIges(path, import) : ReadStep(path, import, annotations));
    const double told = MetresPerUnit(options.unit);  // 0: nothing
    constexpr double kSameUnit = 1e-6;                // a share
    const bool other = told > 0.0 && std::abs(told / import.metres_per_unit - 1.0) > kSameUnit;
    if (other && import.unit_from_file) {
      return absl::InvalidArgumentError(absl::StrCat(
          "units: ", path, " is in ", import.unit_name, " by its own word, not in ", options.unit));
    }
    if (other && !shape.IsNull()) {  // read as mm, for want of a word
      gp_Trsf scaling;
      scaling.SetScale(gp_Pnt(), told / import.metres_per_unit);
      shape = BRepBuilderAPI_Transform(shape, scaling).Shape();
      SetUnit(options.unit, told, &import);
      import.unit_from_file = false;
    }
    return use(shape, annotations, std::move(import));
  } catch (const Standard_Failure& failure) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": cannot be read: ", failure.GetMessageString()));
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": cannot be read: ", e.what()));
  }
}

}  // namespace

absl::StatusOr<CadImport> ImportBrep(const std::string& path,
                                     bool iges,
                                     const CadImportOptions& options) {
  return WithShape<CadImport>(
      path,
      iges,
      options,
      [&](const TopoDS_Shape& shape,
          const Annotations& annotations,
          CadImport import) -> absl::StatusOr<CadImport> {
        import.name = NameOfWhole(shape, annotations);
        HOROPTER_RETURN_IF_ERROR(ImportShape(path, shape, annotations, options, import));
        return import;
      });
}

absl::StatusOr<std::vector<CadImport>> ImportBrepSolids(const std::string& path,
                                                        bool iges,
                                                        const CadImportOptions& options) {
  using Imports = std::vector<CadImport>;
  return WithShape<Imports>(
      path,
      iges,
      options,
      [&](const TopoDS_Shape& shape,
          const Annotations& annotations,
          const CadImport& base) -> absl::StatusOr<Imports> {
        std::vector<TopoDS_Shape> solids;
        std::vector<int> copies;
        Imports imports;
        if (!shape.IsNull()) {
          for (TopExp_Explorer it(shape, TopAbs_SOLID); it.More(); it.Next()) {
            const auto known = std::find_if(solids.begin(), solids.end(), [&](const auto& solid) {
              return solid.IsPartner(it.Current());  // the same body, placed elsewhere
            });
            if (known != solids.end()) {
              ++copies[static_cast<size_t>(known - solids.begin())];
              continue;
            }
            solids.push_back(it.Current());
            copies.push_back(1);
            imports.push_back(base);
            const auto name = annotations.names.find(it.Current().TShape().get());
            if (name != annotations.names.end()) imports.back().name = name->second;
          }
        }
        if (solids.empty()) {  // surfaces, triangles: one part
          CadImport whole = base;
          whole.name = annotations.root_name;
          HOROPTER_RETURN_IF_ERROR(ImportShape(path, shape, annotations, options, whole));
          return Imports{std::move(whole)};
        }
        for (size_t i = 0; i < solids.size(); ++i) {
          HOROPTER_RETURN_IF_ERROR(ImportShape(path, solids[i], annotations, options, imports[i]));
          if (copies[i] > 1) {
            imports[i].warnings.push_back(
                absl::StrCat("solid ", i + 1, " is there ", copies[i], " times; taken once"));
          }
        }
        return imports;
      });
}

}  // namespace horopter
