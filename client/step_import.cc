#include "client/step_import.h"

#include <BRepAdaptor_Curve.hxx>
#include <BRepBndLib.hxx>
#include <BRepGProp_Face.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRep_Tool.hxx>
#include <Bnd_Box.hxx>
#include <Eigen/Geometry>
#include <GCPnts_TangentialDeflection.hxx>
#include <IGESControl_Reader.hxx>
#include <IGESData_GlobalSection.hxx>
#include <IGESData_IGESModel.hxx>
#include <Interface_Static.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Message_PrinterOStream.hxx>
#include <NCollection_DataMap.hxx>
#include <Poly_Triangulation.hxx>
#include <Quantity_Color.hxx>
#include <STEPConstruct.hxx>
#include <STEPConstruct_Styles.hxx>
#include <STEPControl_Reader.hxx>
#include <Standard_Failure.hxx>
#include <StepRepr_RepresentationItem.hxx>
#include <StepVisual_Colour.hxx>
#include <StepVisual_StyledItem.hxx>
#include <TColStd_SequenceOfAsciiString.hxx>
#include <TCollection_HAsciiString.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopTools_IndexedMapOfShape.hxx>
#include <TopTools_OrientedShapeMapHasher.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Face.hxx>
#include <TopoDS_Iterator.hxx>
#include <TopoDS_Vertex.hxx>
#include <Transfer_TransientProcess.hxx>
#include <XSControl_TransferReader.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <fstream>
#include <iterator>
#include <map>
#include <sstream>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/cad_findings.h"
#include "client/edge_chains.h"
#include "client/mesh_topology.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr double kMetresPerMm = 1e-3;               // OpenCASCADE hands everything out in mm
constexpr double kCircleStepRad = 2.0 * M_PI / 32;  // at most; chord error 0.5 % of the radius

Eigen::Vector3d Metres(const gp_Pnt& p) {
  return kMetresPerMm * Eigen::Vector3d(p.X(), p.Y(), p.Z());
}

// A file cut short is often read without complaint, as the part it no longer is.
absl::Status CheckComplete(const std::string& path, bool iges) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream buffer;
  buffer << file.rdbuf();
  const std::string text = buffer.str();
  if (iges) {
    // The last record is the terminate section: letter T in column 73.
    const size_t end = text.find_last_not_of(" \r\n\t");
    const size_t line = end == std::string::npos ? end : text.rfind('\n', end);
    const size_t start = line == std::string::npos ? 0 : line + 1;
    if (end == std::string::npos || end < start + 72 || text[start + 72] != 'T') {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": not an IGES file, or cut short (no terminate section)"));
    }
    return absl::OkStatus();
  }
  if (text.substr(0, 4096).find("ISO-10303-21") == std::string::npos) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": not a STEP file (no ISO-10303-21 header)"));
  }
  if (text.find("END-ISO-10303-21") == std::string::npos) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": cut short (no END-ISO-10303-21 at the end)"));
  }
  return absl::OkStatus();
}

// Short name of a unit as CAD systems write it ("MILLIMETRE" -> "mm"); the word itself when it is
// unusual.
std::string ShortUnit(const std::string& word) {
  const double metres = MetresPerUnit(word);
  for (const char* unit : {"mm", "cm", "m", "in", "ft", "um"}) {
    if (metres > 0.0 && std::abs(MetresPerUnit(unit) / metres - 1.0) < 1e-9) return unit;
  }
  return absl::AsciiStrToLower(word);
}

void SetUnit(CadImport& import, const std::string& word) {
  import.unit_name = ShortUnit(word);
  import.metres_per_unit = MetresPerUnit(word);
  import.unit_from_file = true;
}

// What the file calls a solid; writers put their own program's words where no one named it.
std::string NameOf(const STEPControl_Reader& reader, const TopoDS_Shape& solid) {
  const Handle(Standard_Transient) entity =
      reader.WS()->TransferReader()->EntityFromShapeResult(solid, 1);
  const auto item = Handle(StepRepr_RepresentationItem)::DownCast(entity);
  if (item.IsNull() || item->Name().IsNull()) return "";
  const std::string name = item->Name()->ToCString();
  // Long words and bytes that may be no UTF-8 would be refused as a display name.
  constexpr size_t kLongest = 100;
  const bool plain = name.size() <= kLongest && std::all_of(name.begin(), name.end(), [](char c) {
                       return absl::ascii_isprint(static_cast<unsigned char>(c));
                     });
  return !plain || absl::StrContains(name, "Open CASCADE") || name == "NONE" ? "" : name;
}

// What a file says of its bodies beside their geometry.
struct Annotations {
  std::vector<std::string> names;               // of the solids in the order of TopExp_Explorer
  std::map<const TopoDS_TShape*, Rgba> colors;  // of faces, solids and assemblies, wherever placed
};

// Surface colours as styled items give them; what nothing is styled is left out.
std::map<const TopoDS_TShape*, Rgba> ColorsOf(const STEPControl_Reader& reader) {
  std::map<const TopoDS_TShape*, Rgba> colors;
  STEPConstruct_Styles styles(reader.WS());
  if (!styles.LoadStyles()) return colors;
  const auto process = reader.WS()->TransferReader()->TransientProcess();
  for (int i = 1; i <= styles.NbStyles(); ++i) {
    const Handle(StepVisual_StyledItem) style = styles.Style(i);
    Handle(StepVisual_Colour) surface, border, curve, rendering;
    double transparency = 0.0;
    bool is_component = false;
    if (style.IsNull() ||
        !styles.GetColors(style, surface, border, curve, rendering, transparency, is_component)) {
      continue;
    }
    if (surface.IsNull()) surface = rendering;
    const auto item = Handle(StepRepr_RepresentationItem)::DownCast(style->ItemAP242().Value());
    Quantity_Color color;
    if (item.IsNull() || surface.IsNull() || !STEPConstruct_Styles::DecodeColor(surface, color)) {
      continue;
    }
    const TopoDS_Shape shape = STEPConstruct::FindShape(process, item);
    if (shape.IsNull()) continue;
    double rgb[3];
    color.Values(rgb[0], rgb[1], rgb[2], Quantity_TOC_sRGB);
    Rgba& out = colors[shape.TShape().get()];
    for (int k = 0; k < 3; ++k) {
      out[k] = static_cast<std::uint8_t>(std::lround(255.0 * std::clamp(rgb[k], 0.0, 1.0)));
    }
    // Opacity 0 stands for no colour; what the file makes invisible still has one.
    out[3] =
        static_cast<std::uint8_t>(std::lround(255.0 - 254.0 * std::clamp(transparency, 0.0, 1.0)));
  }
  return colors;
}

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

absl::StatusOr<TopoDS_Shape> ReadStep(const std::string& path,
                                      CadImport& import,
                                      Annotations& annotations) {
  STEPControl_Reader reader;
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  if (reader.ReadFile(path.c_str()) != IFSelect_RetDone) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not a readable STEP file"));
  }
  TColStd_SequenceOfAsciiString lengths, angles, solid_angles;
  reader.FileUnits(lengths, angles, solid_angles);
  if (lengths.IsEmpty()) {
    import.warnings.push_back("the file names no length unit; mm assumed");
    SetUnit(import, "mm");
    import.unit_from_file = false;
  } else {
    SetUnit(import, lengths.First().ToCString());
    for (int i = 2; i <= lengths.Length(); ++i) {
      if (!(lengths.Value(i) == lengths.First())) {
        import.warnings.push_back("the file mixes length units; each is converted by its own");
        break;
      }
    }
  }
  reader.TransferRoots();
  const TopoDS_Shape shape = reader.OneShape();
  if (shape.IsNull()) return shape;
  for (TopExp_Explorer it(shape, TopAbs_SOLID); it.More(); it.Next()) {
    annotations.names.push_back(NameOf(reader, it.Current()));
  }
  annotations.colors = ColorsOf(reader);
  return shape;
}

absl::StatusOr<TopoDS_Shape> ReadIges(const std::string& path, CadImport& import) {
  IGESControl_Reader reader;
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  if (reader.ReadFile(path.c_str()) != IFSelect_RetDone) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not a readable IGES file"));
  }
  const auto name = reader.IGESModel()->GlobalSection().UnitName();
  SetUnit(import, name.IsNull() ? "mm" : name->ToCString());
  reader.TransferRoots();
  return reader.OneShape();
}

// Surfaces of faces, each made ready once: that takes a look at all edges around the face.
class FaceNormals {
 public:
  // Outward normals of a face at shares of the length of its edge; zero where the surface is
  // singular.
  std::array<Eigen::Vector3d, 3> Along(const TopoDS_Edge& edge,
                                       const TopoDS_Face& face,
                                       const std::array<double, 3>& shares) {
    std::array<Eigen::Vector3d, 3> out;
    out.fill(Eigen::Vector3d::Zero());
    double first = 0.0, last = 0.0;
    const Handle(Geom2d_Curve) curve = BRep_Tool::CurveOnSurface(edge, face, first, last);
    if (curve.IsNull()) return out;
    const BRepGProp_Face& surface = SurfaceOf(face);
    for (size_t i = 0; i < shares.size(); ++i) {
      const gp_Pnt2d uv = curve->Value(first + shares[i] * (last - first));
      gp_Pnt point;
      gp_Vec normal;
      surface.Normal(uv.X(), uv.Y(), point, normal);
      const Eigen::Vector3d n(normal.X(), normal.Y(), normal.Z());
      if (n.norm() > 1e-12) out[i] = n.normalized();
    }
    return out;
  }

 private:
  const BRepGProp_Face& SurfaceOf(const TopoDS_Face& face) {
    if (const BRepGProp_Face* known = surfaces_.Seek(face)) return *known;
    return *surfaces_.Bound(face, BRepGProp_Face(face));
  }

  NCollection_DataMap<TopoDS_Shape, BRepGProp_Face, TopTools_OrientedShapeMapHasher> surfaces_;
};

// Largest angle between the outward normals of the two faces along the edge; pi at an open border,
// -1 when unknown.
double Dihedral(const TopoDS_Edge& edge, const TopTools_ListOfShape& faces, FaceNormals& normals) {
  const TopoDS_Face face_1 = TopoDS::Face(faces.First());
  TopoDS_Face face_2 = face_1;
  for (const TopoDS_Shape& f : faces) {
    if (!f.IsSame(face_1)) face_2 = TopoDS::Face(f);
  }
  TopoDS_Edge edge_2 = edge;
  if (face_2.IsSame(face_1)) {
    if (!BRep_Tool::IsClosed(edge, face_1)) return M_PI;
    edge_2 = TopoDS::Edge(edge.Reversed());  // a seam: the second curve on the same surface
  }
  double angle = -1.0;
  constexpr std::array<double, 3> kShares = {0.25, 0.5, 0.75};
  const auto along_1 = normals.Along(edge, face_1, kShares);
  const auto along_2 = normals.Along(edge_2, face_2, kShares);
  for (size_t i = 0; i < kShares.size(); ++i) {
    const Eigen::Vector3d &n1 = along_1[i], &n2 = along_2[i];
    if (n1.isZero() || n2.isZero()) continue;
    angle = std::max(angle, std::atan2(n1.cross(n2).norm(), n1.dot(n2)));
  }
  return angle;
}

CurveKind KindOf(const BRepAdaptor_Curve& curve, const std::vector<Eigen::Vector3d>& points) {
  if (curve.GetType() == GeomAbs_Line) return CurveKind::kLine;
  if (curve.GetType() == GeomAbs_Circle) return CurveKind::kCircle;
  // Exporters write lines and circles as splines, too.
  double length = 0.0;
  for (size_t i = 1; i < points.size(); ++i) length += (points[i] - points[i - 1]).norm();
  const double tolerance = 1e-5 * length;
  if (AllOnLine(points, tolerance)) return CurveKind::kLine;
  if (points.size() > 4 && CircleThrough(points, tolerance)) return CurveKind::kCircle;
  return CurveKind::kOther;
}

ModelEdge SampleEdge(const TopoDS_Edge& edge, double dihedral, double chord_error_mm) {
  const BRepAdaptor_Curve curve(edge);
  const double first = curve.FirstParameter(), last = curve.LastParameter();
  ModelEdge out;
  out.dihedral_rad = dihedral;
  if (curve.GetType() == GeomAbs_Line) {
    out.polyline = {Metres(curve.Value(first)), Metres(curve.Value(last))};
  } else if (curve.GetType() == GeomAbs_Circle) {
    const double radius = std::max(curve.Circle().Radius(), 1e-9);
    const double step =
        std::min(kCircleStepRad, 2.0 * std::acos(std::max(0.5, 1.0 - chord_error_mm / radius)));
    const int n = std::max(2, static_cast<int>(std::ceil((last - first) / step - 1e-9)));
    for (int i = 0; i <= n; ++i) {
      out.polyline.push_back(Metres(curve.Value(first + (last - first) * i / n)));
    }
  } else {
    const GCPnts_TangentialDeflection sampler(curve, kCircleStepRad, chord_error_mm, 5);
    for (int i = 1; i <= sampler.NbPoints(); ++i) out.polyline.push_back(Metres(sampler.Value(i)));
  }
  out.kind = KindOf(curve, out.polyline);
  if (out.kind == CurveKind::kLine) out.polyline = {out.polyline.front(), out.polyline.back()};
  return out;
}

void ExtractEdges(const TopoDS_Shape& shape,
                  const CadImportOptions& options,
                  double chord_error_mm,
                  CadImport& import) {
  TopTools_IndexedDataMapOfShapeListOfShape faces_of_edge;
  TopExp::MapShapesAndAncestors(shape, TopAbs_EDGE, TopAbs_FACE, faces_of_edge);
  TopTools_IndexedMapOfShape vertices;
  FaceNormals normals;
  ObjectModel& model = import.model;
  int unknown = 0;
  for (int i = 1; i <= faces_of_edge.Extent(); ++i) {
    const TopoDS_Edge edge = TopoDS::Edge(faces_of_edge.FindKey(i));
    if (BRep_Tool::Degenerated(edge) || faces_of_edge(i).IsEmpty()) continue;
    const double dihedral = Dihedral(edge, faces_of_edge(i), normals);
    unknown += dihedral < 0.0;
    if (dihedral < options.sharp_angle_rad) continue;
    ModelEdge out = SampleEdge(edge, dihedral, chord_error_mm);
    const TopoDS_Vertex ends[2] = {TopExp::FirstVertex(edge), TopExp::LastVertex(edge)};
    int index[2] = {-1, -1};
    for (int k = 0; k < 2; ++k) {
      if (ends[k].IsNull()) continue;
      index[k] = vertices.Add(ends[k]) - 1;
      if (index[k] == static_cast<int>(model.vertices.size())) {
        model.vertices.push_back(Metres(BRep_Tool::Pnt(ends[k])));
      }
    }
    if (index[0] < 0 || index[1] < 0) index[0] = index[1] = -1;
    out.start_vertex = index[0];
    out.end_vertex = index[1];
    if (index[0] >= 0) {  // the ends equal the named vertices exactly
      out.polyline.front() = model.vertices[index[0]];
      out.polyline.back() = model.vertices[index[1]];
    } else {
      out.polyline.back() = out.polyline.front();
    }
    model.edges.push_back(std::move(out));
  }
  if (unknown > 0) {
    import.warnings.push_back(absl::StrCat(unknown, " edges lie on singular surfaces; left out"));
  }
}

TriangleMesh Triangulate(const TopoDS_Shape& shape,
                         const Annotations& annotations,
                         double chord_error_mm) {
  constexpr double kAngularDeflection = 0.35;  // 20 degrees: 18 facets of a hole at least
  BRepMesh_IncrementalMesh mesher(shape, chord_error_mm, false, kAngularDeflection, false);
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

// Reads the file and hands its shape to `use`; what OpenCASCADE throws becomes a status.
template <typename Result, typename Use>
absl::StatusOr<Result> WithShape(const std::string& path,
                                 bool iges,
                                 const CadImportOptions& options,
                                 const Use& use) {
  HOROPTER_RETURN_IF_ERROR(CheckComplete(path, iges));
  Message::DefaultMessenger()->RemovePrinters(STANDARD_TYPE(Message_PrinterOStream));
  CadImport import;
  Annotations annotations;
  try {
    HOROPTER_ASSIGN_OR_RETURN(const TopoDS_Shape shape,
                              iges ? ReadIges(path, import) : ReadStep(path, import, annotations));
    if (!options.unit.empty() &&
        std::abs(MetresPerUnit(options.unit) - import.metres_per_unit) > 1e-12) {
      return absl::InvalidArgumentError(absl::StrCat(
          "units: ", path, " is in ", import.unit_name, " by its own word, not in ", options.unit));
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
        if (annotations.names.size() == 1) {
          import.name = annotations.names[0];
        }
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
          int number = 0;
          for (TopExp_Explorer it(shape, TopAbs_SOLID); it.More(); it.Next(), ++number) {
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
            if (number < std::ssize(annotations.names)) {
              imports.back().name = annotations.names[number];
            }
          }
        }
        if (solids.empty()) return absl::InvalidArgumentError(absl::StrCat(path, ": no solids"));
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
