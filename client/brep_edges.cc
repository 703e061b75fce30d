#include "client/brep_edges.h"

#include <BRepAdaptor_Curve.hxx>
#include <BRepGProp_Face.hxx>
#include <BRep_Tool.hxx>
#include <Eigen/Geometry>
#include <GCPnts_TangentialDeflection.hxx>
#include <NCollection_DataMap.hxx>
#include <TopExp.hxx>
#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopTools_IndexedMapOfShape.hxx>
#include <TopTools_OrientedShapeMapHasher.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Face.hxx>
#include <TopoDS_Vertex.hxx>
#include <algorithm>
#include <array>
#include <cmath>

#include "client/cad_findings.h"
#include "client/edge_chains.h"
#include "client/units.h"

namespace horopter {
namespace {

constexpr double kCircleStepRad = 2.0 * M_PI / 32;  // at most; chord error 0.5 % of the radius

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

}  // namespace

Eigen::Vector3d Metres(const gp_Pnt& p) {
  return kMetresPerMm * Eigen::Vector3d(p.X(), p.Y(), p.Z());
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

}  // namespace horopter
