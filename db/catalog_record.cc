#include "db/catalog_record.h"

#include <Eigen/Dense>
#include <set>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

// A stored rotation may be off by rounding and by a quaternion normalised in single precision.
constexpr double kRotationTolerance = 1e-5;

absl::Status Bad(const std::string& field, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(field, ": ", what));
}

std::string At(const char* field, size_t index) {
  return absl::StrCat(field, "[", index, "]");
}

absl::Status ValidatePoints(const std::vector<Eigen::Vector3d>& points, const std::string& field) {
  for (size_t i = 0; i < points.size(); ++i) {
    if (!points[i].allFinite()) {
      return Bad(field, absl::StrCat("point ", i, " is not finite"));
    }
  }
  return absl::OkStatus();
}

absl::Status ValidateRigid(const Rigid3& a_from_b, const std::string& field) {
  if (!a_from_b.R.allFinite() || !a_from_b.t.allFinite()) return Bad(field, "not finite");
  const double error = (a_from_b.R.transpose() * a_from_b.R - Eigen::Matrix3d::Identity()).norm();
  if (error > kRotationTolerance || a_from_b.R.determinant() < 0) {
    return Bad(field, "not a rotation");
  }
  return absl::OkStatus();
}

absl::Status ValidateMesh(const TriangleMesh& mesh) {
  if (mesh.vertices.size() < 3 || mesh.vertices.size() > kMaxMeshVertices) {
    return Bad("mesh.vertices_m",
               absl::StrCat(mesh.vertices.size(), " vertices, need 3 to ", kMaxMeshVertices));
  }
  if (mesh.triangles.empty() || mesh.triangles.size() > kMaxTriangles) {
    return Bad("mesh.triangles",
               absl::StrCat(mesh.triangles.size(), " triangles, need 1 to ", kMaxTriangles));
  }
  HOROPTER_RETURN_IF_ERROR(ValidatePoints(mesh.vertices, "mesh.vertices_m"));
  const int count = static_cast<int>(mesh.vertices.size());
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    if (mesh.triangles[i].minCoeff() < 0 || mesh.triangles[i].maxCoeff() >= count) {
      return Bad("mesh.triangles",
                 absl::StrCat("triangle ", i, " names a vertex outside 0..", count - 1));
    }
  }
  if (!mesh.colors.empty() && mesh.colors.size() != mesh.triangles.size()) {
    return Bad(
        "mesh.triangle_colors_rgba",
        absl::StrCat(mesh.colors.size(), " colours for ", mesh.triangles.size(), " triangles"));
  }
  return absl::OkStatus();
}

absl::Status ValidateEdge(const ModelEdge& edge,
                          const ObjectModel& model,
                          const std::string& field) {
  if (edge.kind != CurveKind::kLine && edge.kind != CurveKind::kCircle &&
      edge.kind != CurveKind::kOther) {
    return Bad(field + ".kind", "unknown");
  }
  if (!(edge.dihedral_rad >= 0.0 && edge.dihedral_rad <= M_PI + 1e-9)) {
    return Bad(field + ".dihedral_rad", absl::StrCat(edge.dihedral_rad, " is outside 0..pi"));
  }
  const std::string polyline = field + ".polyline_m";
  if (edge.polyline.size() < 2 || edge.polyline.size() > kMaxPolylinePoints) {
    return Bad(polyline,
               absl::StrCat(edge.polyline.size(), " points, need 2 to ", kMaxPolylinePoints));
  }
  HOROPTER_RETURN_IF_ERROR(ValidatePoints(edge.polyline, polyline));
  if (edge.start_vertex == -1 && edge.end_vertex == -1) {
    if ((edge.polyline.front() - edge.polyline.back()).norm() > kEdgeEndToleranceM) {
      return Bad(polyline, "a closed curve (no end vertices) must repeat its first point");
    }
    return absl::OkStatus();
  }
  const int count = static_cast<int>(model.vertices.size());
  for (const int vertex : {edge.start_vertex, edge.end_vertex}) {
    if (vertex < 0 || vertex >= count) {
      return Bad(field, absl::StrCat("end vertex ", vertex, " is outside 0..", count - 1));
    }
  }
  const double start_gap = (edge.polyline.front() - model.vertices[edge.start_vertex]).norm();
  const double end_gap = (edge.polyline.back() - model.vertices[edge.end_vertex]).norm();
  if (std::max(start_gap, end_gap) > kEdgeEndToleranceM) {
    return Bad(
        polyline,
        absl::StrCat("ends are ", std::max(start_gap, end_gap), " m off the named vertices"));
  }
  return absl::OkStatus();
}

absl::Status ValidateGripper(const Grasp& grasp, const std::string& field) {
  const auto in_range = [&](double value, const char* name) -> absl::Status {
    if (value >= 0.0 && value <= kMaxDiameterM) return absl::OkStatus();
    return Bad(field + name, absl::StrCat(value, " m is out of range"));
  };
  if (IsSuction(grasp)) {
    if (!(CupRadius(grasp) > 0.0)) {
      return Bad(field + ".suction.cup_radius_m",
                 absl::StrCat(CupRadius(grasp), " m is no radius"));
    }
    return in_range(CupRadius(grasp), ".suction.cup_radius_m");
  }
  HOROPTER_RETURN_IF_ERROR(in_range(grasp.jaw_opening_m, ".parallel_jaw.jaw_opening_m"));
  return in_range(grasp.grip_width_m, ".parallel_jaw.grip_width_m");
}

bool OnlyOf(const std::string& text, const char* allowed) {
  return text.find_first_not_of(allowed) == std::string::npos;
}

}  // namespace

bool IsObjectId(const std::string& id) {
  return !id.empty() && id.size() <= 63 && OnlyOf(id, "abcdefghijklmnopqrstuvwxyz0123456789_-");
}

absl::Status ValidateGrasps(const std::vector<Grasp>& grasps) {
  if (grasps.size() > kMaxGrasps) {
    return Bad("grasps", absl::StrCat(grasps.size(), " grasps, at most ", kMaxGrasps));
  }
  std::set<std::string> names;
  for (size_t i = 0; i < grasps.size(); ++i) {
    const Grasp& grasp = grasps[i];
    const std::string field = At("grasps", i);
    if (grasp.name.empty() || grasp.name.size() > kMaxGraspNameBytes) {
      return Bad(field + ".name", absl::StrCat("need 1 to ", kMaxGraspNameBytes, " bytes"));
    }
    if (!names.insert(grasp.name).second) {
      return Bad(field + ".name", absl::StrCat("'", grasp.name, "' is there twice"));
    }
    HOROPTER_RETURN_IF_ERROR(
        ValidateRigid(grasp.object_from_gripper, field + ".object_from_gripper"));
    if (grasp.object_from_pregrasp) {
      HOROPTER_RETURN_IF_ERROR(
          ValidateRigid(*grasp.object_from_pregrasp, field + ".object_from_pregrasp"));
    }
    HOROPTER_RETURN_IF_ERROR(ValidateGripper(grasp, field));
    if (!(grasp.quality >= 0.0 && grasp.quality <= 1.0)) {
      return Bad(field + ".quality", absl::StrCat(grasp.quality, " is outside 0..1"));
    }
  }
  return absl::OkStatus();
}

absl::Status ValidateSource(const CadSource& source) {
  if (source.file_name.size() > 255) return Bad("source.file_name", "longer than 255 bytes");
  if (source.format.size() > 16 || !OnlyOf(source.format, "abcdefghijklmnopqrstuvwxyz0123456789")) {
    return Bad("source.format", "must match [a-z0-9]{0,16}");
  }
  if (source.unit.size() > 16) return Bad("source.unit", "longer than 16 bytes");
  if (source.content.size() > kMaxCadBytes) {
    return Bad("source.content",
               absl::StrCat(source.content.size(), " bytes, at most ", kMaxCadBytes));
  }
  if (!source.sha256.empty() &&
      (source.sha256.size() != 64 || !OnlyOf(source.sha256, "0123456789abcdef"))) {
    return Bad("source.sha256", "must be 64 lower-case hex digits");
  }
  return absl::OkStatus();
}

absl::Status ValidateLabels(const std::map<std::string, std::string>& labels) {
  if (labels.size() > kMaxLabels) {
    return Bad("labels", absl::StrCat(labels.size(), " labels, at most ", kMaxLabels));
  }
  for (const auto& [key, value] : labels) {
    if (key.empty() || key.size() > kMaxLabelKeyBytes ||
        !OnlyOf(key, "abcdefghijklmnopqrstuvwxyz0123456789_./-")) {
      return Bad("labels",
                 absl::StrCat("'", key.substr(0, 80), "' does not match [a-z0-9_./-]{1,63}"));
    }
    if (value.size() > kMaxLabelValueBytes) {
      return Bad("labels", absl::StrCat("the value of '", key, "' has more than 255 bytes"));
    }
  }
  return absl::OkStatus();
}

namespace {

absl::Status ValidatePrint(const SurfacePrint& print) {
  constexpr float kUnit = 0.01f;  // by which a normal's length may differ from 1
  if (print.places.size() > kMaxPrintPlaces) {
    return Bad("print.places",
               absl::StrCat(print.places.size(), " places, at most ", kMaxPrintPlaces));
  }
  if (print.views < 0) return Bad("print.view_count", "negative");
  for (const PrintPlace& p : print.places) {
    if (!p.point.allFinite() || !(std::abs(p.normal.norm() - 1.0f) <= kUnit) ||
        !(std::abs(p.brightness) <= 1.0f)) {
      return Bad("print.places", "not a point, a unit normal and a brightness of -1 .. 1");
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status ValidateModel(const ObjectModel& model) {
  if (!IsObjectId(model.id)) {
    return Bad("object_id", absl::StrCat("'", model.id, "' does not match [a-z0-9_-]{1,63}"));
  }
  if (model.display_name.size() > kMaxDisplayNameBytes) {
    return Bad("display_name", absl::StrCat("longer than ", kMaxDisplayNameBytes, " bytes"));
  }
  if (model.vertices.size() > kMaxModelVertices) {
    return Bad("vertices_m", absl::StrCat("more than ", kMaxModelVertices, " vertices"));
  }
  HOROPTER_RETURN_IF_ERROR(ValidatePoints(model.vertices, "vertices_m"));
  if (model.edges.size() > kMaxEdges) {
    return Bad("edges", absl::StrCat(model.edges.size(), " edges, at most ", kMaxEdges));
  }
  for (size_t i = 0; i < model.edges.size(); ++i) {
    HOROPTER_RETURN_IF_ERROR(ValidateEdge(model.edges[i], model, At("edges", i)));
  }
  HOROPTER_RETURN_IF_ERROR(ValidateMesh(model.mesh));
  // After the mesh: a bad mesh makes a bad diameter.
  if (!(model.diameter_m >= kMinDiameterM && model.diameter_m <= kMaxDiameterM)) {
    return Bad("diameter_m",
               absl::StrCat(model.diameter_m,
                            " m is outside ",
                            kMinDiameterM,
                            "..",
                            kMaxDiameterM,
                            " m; is the unit right?"));
  }
  if (model.symmetries.size() > kMaxSymmetries) {
    return Bad("object_from_symmetric_object", absl::StrCat("more than ", kMaxSymmetries));
  }
  for (size_t i = 0; i < model.symmetries.size(); ++i) {
    HOROPTER_RETURN_IF_ERROR(
        ValidateRigid(model.symmetries[i], At("object_from_symmetric_object", i)));
  }
  HOROPTER_RETURN_IF_ERROR(ValidatePrint(model.print));
  return ValidateGrasps(model.grasps);
}

}  // namespace horopter
