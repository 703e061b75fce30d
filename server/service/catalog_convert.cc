#include "server/service/catalog_convert.h"

#include <google/protobuf/field_mask.pb.h>
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "horopter/v1/catalog.pb.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

using Coordinates = google::protobuf::RepeatedField<double>;

constexpr double kDiameterTolerance = 0.01;

absl::StatusOr<std::vector<Eigen::Vector3d>> PointsFromProto(const Coordinates& proto,
                                                             const std::string& field) {
  if (proto.size() % 3 != 0) {
    return InvalidField(field, absl::StrCat(proto.size(), " numbers, not a multiple of 3"));
  }
  std::vector<Eigen::Vector3d> points(proto.size() / 3);
  for (size_t i = 0; i < points.size(); ++i) {
    const int at = static_cast<int>(3 * i);
    points[i] = {proto[at], proto[at + 1], proto[at + 2]};
  }
  return points;
}

void PointsToProto(const std::vector<Eigen::Vector3d>& points, Coordinates* proto) {
  proto->Reserve(static_cast<int>(3 * points.size()));
  for (const Eigen::Vector3d& point : points) {
    for (int i = 0; i < 3; ++i) proto->Add(point[i]);
  }
}

absl::StatusOr<CurveKind> KindFromProto(v1::ModelEdge::CurveKind kind, const std::string& field) {
  switch (kind) {
    case v1::ModelEdge::CURVE_KIND_LINE:
      return CurveKind::kLine;
    case v1::ModelEdge::CURVE_KIND_CIRCLE:
      return CurveKind::kCircle;
    case v1::ModelEdge::CURVE_KIND_OTHER:
      return CurveKind::kOther;
    default:
      return InvalidField(field, "unset or unknown");
  }
}

v1::ModelEdge::CurveKind KindToProto(CurveKind kind) {
  switch (kind) {
    case CurveKind::kLine:
      return v1::ModelEdge::CURVE_KIND_LINE;
    case CurveKind::kCircle:
      return v1::ModelEdge::CURVE_KIND_CIRCLE;
    case CurveKind::kOther:
      return v1::ModelEdge::CURVE_KIND_OTHER;
  }
  return v1::ModelEdge::CURVE_KIND_UNSPECIFIED;
}

absl::StatusOr<std::vector<ModelEdge>> EdgesFromProto(const v1::Object& proto) {
  std::vector<ModelEdge> edges;
  edges.reserve(proto.edges_size());
  for (int i = 0; i < proto.edges_size(); ++i) {
    const v1::ModelEdge& in = proto.edges(i);
    const std::string field = absl::StrCat("edges[", i, "]");
    ModelEdge edge;
    HOROPTER_ASSIGN_OR_RETURN(edge.kind, KindFromProto(in.kind(), field + ".kind"));
    if (in.has_start_vertex() != in.has_end_vertex()) {
      return InvalidField(field + ".start_vertex", "start and end must be set together");
    }
    if (in.has_start_vertex()) {
      // -1 means "closed" in the domain and nothing on the wire.
      if (in.start_vertex() < 0 || in.end_vertex() < 0)
        return InvalidField(field + ".start_vertex", "negative index");
      edge.start_vertex = in.start_vertex();
      edge.end_vertex = in.end_vertex();
    }
    edge.dihedral_rad = in.dihedral_rad();
    HOROPTER_ASSIGN_OR_RETURN(edge.polyline,
                              PointsFromProto(in.polyline_m(), field + ".polyline_m"));
    edges.push_back(std::move(edge));
  }
  return edges;
}

absl::StatusOr<TriangleMesh> MeshFromProto(const v1::TriangleMesh& proto) {
  TriangleMesh mesh;
  HOROPTER_ASSIGN_OR_RETURN(mesh.vertices, PointsFromProto(proto.vertices_m(), "mesh.vertices_m"));
  if (proto.triangles_size() % 3 != 0) {
    return InvalidField("mesh.triangles",
                        absl::StrCat(proto.triangles_size(), " indices, not a multiple of 3"));
  }
  mesh.triangles.reserve(proto.triangles_size() / 3);
  for (int i = 0; i < proto.triangles_size(); i += 3) {
    mesh.triangles.emplace_back(proto.triangles(i), proto.triangles(i + 1), proto.triangles(i + 2));
  }
  const std::string& colors = proto.triangle_colors_rgba();
  if (!colors.empty() && colors.size() != 4 * mesh.triangles.size()) {
    return InvalidField(
        "mesh.triangle_colors_rgba",
        absl::StrCat(
            colors.size(), " bytes for ", mesh.triangles.size(), " triangles, need 4 each"));
  }
  mesh.colors.resize(colors.size() / 4);
  if (!colors.empty()) std::memcpy(mesh.colors.data(), colors.data(), colors.size());
  return mesh;
}

absl::StatusOr<std::vector<Rigid3>> SymmetriesFromProto(const v1::Object& proto) {
  std::vector<Rigid3> symmetries;
  for (int i = 0; i < proto.object_from_symmetric_object_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(
        Rigid3 symmetry,
        RigidFromProto(proto.object_from_symmetric_object(i),
                       absl::StrCat("object_from_symmetric_object[", i, "]")));
    symmetries.push_back(symmetry);
  }
  return symmetries;
}

absl::StatusOr<std::vector<Grasp>> GraspsFromProto(const v1::Object& proto) {
  std::vector<Grasp> grasps;
  for (int i = 0; i < proto.grasps_size(); ++i) {
    const v1::Grasp& in = proto.grasps(i);
    Grasp grasp;
    grasp.name = in.name();
    HOROPTER_ASSIGN_OR_RETURN(grasp.object_from_gripper,
                              RigidFromProto(in.object_from_gripper(),
                                             absl::StrCat("grasps[", i, "].object_from_gripper")));
    switch (in.gripper_case()) {
      case v1::Grasp::kParallelJaw:
        if (!(in.parallel_jaw().jaw_opening_m() >= 0.0)) {
          return InvalidField(absl::StrCat("grasps[", i, "].parallel_jaw.jaw_opening_m"),
                              "not a length");
        }
        grasp.jaw_opening_m = in.parallel_jaw().jaw_opening_m();
        grasp.grip_width_m = in.parallel_jaw().grip_width_m();
        break;
      case v1::Grasp::kSuction:
        SetSuction(in.suction().cup_radius_m(), &grasp);
        break;
      case v1::Grasp::GRIPPER_NOT_SET:
        return InvalidField(absl::StrCat("grasps[", i, "].gripper"),
                            "neither parallel_jaw nor suction is set");
    }
    if (in.has_quality()) grasp.quality = in.quality();
    if (in.has_object_from_pregrasp()) {
      HOROPTER_ASSIGN_OR_RETURN(
          grasp.object_from_pregrasp,
          RigidFromProto(in.object_from_pregrasp(),
                         absl::StrCat("grasps[", i, "].object_from_pregrasp")));
    }
    grasps.push_back(std::move(grasp));
  }
  return grasps;
}

constexpr int kNumbersOfPlace = 7;

// What the numbers may be is left to ValidateModel.
absl::StatusOr<SurfacePrint> PrintFromProto(const v1::SurfacePrint& proto) {
  if (proto.places_size() % kNumbersOfPlace != 0)
    return InvalidField("print.places", "not seven numbers a place");
  SurfacePrint print;
  print.views = proto.view_count();
  for (int i = 0; i < proto.places_size(); i += kNumbersOfPlace) {
    const float* n = proto.places().data() + i;
    print.places.push_back({{n[0], n[1], n[2]}, {n[3], n[4], n[5]}, n[6]});
  }
  return print;
}

void PrintCountsToProto(const SurfacePrint& print, v1::Object* proto) {
  if (print.places.empty()) return;
  proto->mutable_print()->set_place_count(static_cast<int>(print.places.size()));
  proto->mutable_print()->set_view_count(print.views);
}

void PrintToProto(const SurfacePrint& print, v1::Object* proto) {
  for (const PrintPlace& p : print.places) {
    for (const float x : {p.point.x(), p.point.y(), p.point.z()})
      proto->mutable_print()->add_places(x);
    for (const float x : {p.normal.x(), p.normal.y(), p.normal.z()})
      proto->mutable_print()->add_places(x);
    proto->mutable_print()->add_places(p.brightness);
  }
}

CadSource SourceFromProto(const v1::CadSource& proto) {
  CadSource source;
  source.file_name = proto.file_name();
  source.format = proto.format();
  source.unit = proto.unit();
  source.content = proto.content();
  source.sha256 = proto.sha256();
  source.size_bytes = static_cast<int64_t>(source.content.size());
  return source;
}

absl::Status SettleDiameter(ObjectModel& model) {
  const double measured = PointSetDiameter(model.mesh.vertices);
  if (measured == 0.0)
    return absl::OkStatus();  // the catalog's check names what is wrong with the mesh
  if (model.diameter_m == 0.0) {
    model.diameter_m = measured;
    return absl::OkStatus();
  }
  if (!(std::abs(model.diameter_m - measured) <= kDiameterTolerance * measured)) {
    return InvalidField(
        "diameter_m", absl::StrCat(model.diameter_m, " m, but the mesh measures ", measured, " m"));
  }
  return absl::OkStatus();
}

void CommonToProto(const CatalogRecord& record, v1::Object* proto) {
  using google::protobuf::util::TimeUtil;
  const ObjectModel& model = record.model;
  proto->set_name(ObjectName(model.id));
  proto->set_display_name(model.display_name);
  // Stored by this server in this format; a time edited by hand into something else stays unset.
  if (!TimeUtil::FromString(record.create_time, proto->mutable_create_time()))
    proto->clear_create_time();
  if (!TimeUtil::FromString(record.update_time, proto->mutable_update_time()))
    proto->clear_update_time();
  proto->set_diameter_m(model.diameter_m);
  proto->set_etag(EtagOf(record));
  proto->set_revision(record.revision);
  for (const auto& [key, value] : record.labels) (*proto->mutable_labels())[key] = value;
  PrintCountsToProto(model.print, proto);
  for (const Rigid3& symmetry : model.symmetries)
    RigidToProto(symmetry, proto->add_object_from_symmetric_object());
  for (const Grasp& grasp : model.grasps) {
    v1::Grasp* out = proto->add_grasps();
    out->set_name(grasp.name);
    RigidToProto(grasp.object_from_gripper, out->mutable_object_from_gripper());
    if (IsSuction(grasp)) {
      out->mutable_suction()->set_cup_radius_m(CupRadius(grasp));
    } else {
      out->mutable_parallel_jaw()->set_jaw_opening_m(grasp.jaw_opening_m);
      out->mutable_parallel_jaw()->set_grip_width_m(grasp.grip_width_m);
    }
    out->set_quality(grasp.quality);
    if (grasp.object_from_pregrasp) {
      RigidToProto(*grasp.object_from_pregrasp, out->mutable_object_from_pregrasp());
    }
  }
  const CadSource& source = record.source;
  if (source.file_name.empty() && source.format.empty() && source.size_bytes == 0) return;
  v1::CadSource* out = proto->mutable_source();
  out->set_file_name(source.file_name);
  out->set_format(source.format);
  out->set_unit(source.unit);
  out->set_sha256(source.sha256);
  out->set_size_bytes(source.size_bytes);
}

constexpr ObjectMask kAllFields{true, true, true, true, true, true, true, true, true, true};

ObjectMask PopulatedFields(const v1::Object& object) {
  ObjectMask mask;
  mask.display_name = !object.display_name().empty();
  mask.diameter = object.diameter_m() != 0.0;
  mask.vertices = object.vertices_m_size() > 0;
  mask.edges = object.edges_size() > 0;
  mask.mesh = object.has_mesh();
  mask.symmetries = object.object_from_symmetric_object_size() > 0;
  mask.grasps = object.grasps_size() > 0;
  mask.source = object.has_source();
  mask.labels = object.labels_size() > 0;
  mask.print = object.has_print();
  return mask;
}

void CountsToProto(const ObjectModel& model, v1::Object* proto) {
  proto->set_vertex_count(static_cast<int>(model.vertices.size()));
  proto->set_edge_count(static_cast<int>(model.edges.size()));
  proto->set_triangle_count(static_cast<int>(model.mesh.triangles.size()));
}

}  // namespace

std::string EtagOf(const CatalogRecord& record) {
  constexpr size_t kDigits = 16;
  return Sha256Hex(absl::StrCat(record.model.id, "\n", record.revision, "\n", record.update_time))
      .substr(0, kDigits);
}

absl::StatusOr<CatalogRecord> RecordFromProto(const std::string& id, const v1::Object& proto) {
  CatalogRecord blank;
  blank.model.id = id;
  return MergeRecord(std::move(blank), proto, kAllFields);
}

absl::StatusOr<ObjectMask> MaskFromProto(const google::protobuf::FieldMask& proto,
                                         const v1::Object& object) {
  if (proto.paths_size() == 0) return PopulatedFields(object);
  ObjectMask mask;
  for (const std::string& path : proto.paths()) {
    if (path == "*") {
      if (proto.paths_size() > 1) return InvalidField("update_mask", "'*' must stand alone");
      return kAllFields;
    }
    bool* const field = path == "display_name"                   ? &mask.display_name
                        : path == "diameter_m"                   ? &mask.diameter
                        : path == "vertices_m"                   ? &mask.vertices
                        : path == "edges"                        ? &mask.edges
                        : path == "mesh"                         ? &mask.mesh
                        : path == "object_from_symmetric_object" ? &mask.symmetries
                        : path == "grasps"                       ? &mask.grasps
                        : path == "source"                       ? &mask.source
                        : path == "labels"                       ? &mask.labels
                        : path == "print"                        ? &mask.print
                                                                 : nullptr;
    if (field == nullptr) {
      return InvalidField(
          "update_mask",
          absl::StrCat("'", path.substr(0, 80), "' is not a field that can be written"));
    }
    *field = true;
  }
  return mask;
}

absl::StatusOr<CatalogRecord> MergeRecord(CatalogRecord current,
                                          const v1::Object& proto,
                                          const ObjectMask& mask) {
  ObjectModel& model = current.model;
  if (mask.display_name) model.display_name = proto.display_name();
  if (mask.diameter) model.diameter_m = proto.diameter_m();
  if (mask.vertices) {
    HOROPTER_ASSIGN_OR_RETURN(model.vertices, PointsFromProto(proto.vertices_m(), "vertices_m"));
  }
  if (mask.edges) {
    HOROPTER_ASSIGN_OR_RETURN(model.edges, EdgesFromProto(proto));
  }
  if (mask.mesh) {
    HOROPTER_ASSIGN_OR_RETURN(model.mesh, MeshFromProto(proto.mesh()));
    if (!mask.diameter) model.diameter_m = 0.0;
  }
  if (mask.symmetries) {
    HOROPTER_ASSIGN_OR_RETURN(model.symmetries, SymmetriesFromProto(proto));
  }
  if (mask.grasps) {
    HOROPTER_ASSIGN_OR_RETURN(model.grasps, GraspsFromProto(proto));
  }
  if (mask.source) current.source = SourceFromProto(proto.source());
  if (mask.labels) current.labels = {proto.labels().begin(), proto.labels().end()};
  // It lies on a surface and was learnt under its symmetries.
  if (mask.vertices || mask.edges || mask.mesh || mask.diameter || mask.symmetries)
    model.print = {};
  if (mask.print) {
    HOROPTER_ASSIGN_OR_RETURN(model.print, PrintFromProto(proto.print()));
  }
  // The catalog checks all of it again on writing; here it keeps bad numbers from the diameter and
  // the preparation.
  if (mask.mesh || mask.diameter) {
    HOROPTER_RETURN_IF_ERROR(SettleDiameter(model));
  }
  HOROPTER_RETURN_IF_ERROR(ValidateModel(model));
  HOROPTER_RETURN_IF_ERROR(ValidateSource(current.source));
  HOROPTER_RETURN_IF_ERROR(ValidateLabels(current.labels));
  return current;
}

void WrittenToProto(const CatalogRecord& record, v1::Object* proto) {
  CommonToProto(record, proto);
  CountsToProto(record.model, proto);
}

void SummaryToProto(const ObjectSummary& summary, v1::Object* proto) {
  CommonToProto(summary.record, proto);
  proto->set_vertex_count(summary.vertex_count);
  proto->set_edge_count(summary.edge_count);
  proto->set_triangle_count(summary.triangle_count);
}

void RecordToProto(const CatalogRecord& record, v1::Object* proto) {
  CommonToProto(record, proto);
  const ObjectModel& model = record.model;
  PointsToProto(model.vertices, proto->mutable_vertices_m());
  for (const ModelEdge& edge : model.edges) {
    v1::ModelEdge* out = proto->add_edges();
    out->set_kind(KindToProto(edge.kind));
    if (edge.start_vertex >= 0) {
      out->set_start_vertex(edge.start_vertex);
      out->set_end_vertex(edge.end_vertex);
    }
    out->set_dihedral_rad(edge.dihedral_rad);
    PointsToProto(edge.polyline, out->mutable_polyline_m());
  }
  PointsToProto(model.mesh.vertices, proto->mutable_mesh()->mutable_vertices_m());
  for (const Eigen::Vector3i& triangle : model.mesh.triangles) {
    for (int i = 0; i < 3; ++i) proto->mutable_mesh()->add_triangles(triangle[i]);
  }
  for (const Rgba& color : model.mesh.colors)
    proto->mutable_mesh()->mutable_triangle_colors_rgba()->append(color.begin(), color.end());
  CountsToProto(model, proto);
  PrintToProto(model.print, proto);
}

double PointSetDiameter(const std::vector<Eigen::Vector3d>& points) {
  if (points.size() < 2) return 0.0;
  // The extreme points in directions spread evenly over the half sphere (Fibonacci lattice); then
  // all pairs of them. A direction is at most about sqrt(2 pi / n) = 0.08 rad / 2 from any other,
  // so the loss is below 1 - cos(0.06) = 0.2 %.
  constexpr int kDirections = 1000;
  const double golden_angle = M_PI * (3.0 - std::sqrt(5.0));
  std::vector<int> extremes;
  for (int k = 0; k < kDirections; ++k) {
    const double z = (k + 0.5) / kDirections;
    const double r = std::sqrt(1.0 - z * z);
    const Eigen::Vector3d direction(
        r * std::cos(golden_angle * k), r * std::sin(golden_angle * k), z);
    int low = 0, high = 0;
    double low_value = points[0].dot(direction), high_value = low_value;
    for (size_t i = 1; i < points.size(); ++i) {
      const double value = points[i].dot(direction);
      if (value < low_value) low_value = value, low = static_cast<int>(i);
      if (value > high_value) high_value = value, high = static_cast<int>(i);
    }
    extremes.push_back(low);
    extremes.push_back(high);
  }
  std::sort(extremes.begin(), extremes.end());
  extremes.erase(std::unique(extremes.begin(), extremes.end()), extremes.end());
  double best = 0.0;
  for (size_t i = 0; i < extremes.size(); ++i) {
    for (size_t j = i + 1; j < extremes.size(); ++j) {
      best = std::max(best, (points[extremes[i]] - points[extremes[j]]).squaredNorm());
    }
  }
  return std::sqrt(best);
}

}  // namespace horopter
