#include "client/convert.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "server/base/utf8.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

constexpr char kNamePrefix[] = "objects/";

template <typename Repeated>
void AppendPoints(const std::vector<Eigen::Vector3d>& points, Repeated* out) {
  out->Reserve(static_cast<int>(3 * points.size()));
  for (const Eigen::Vector3d& p : points) {
    for (int k = 0; k < 3; ++k) out->Add(p[k]);
  }
}

template <typename Repeated>
std::vector<Eigen::Vector3d> PointsOf(const Repeated& numbers) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i + 2 < numbers.size(); i += 3) {
    points.emplace_back(numbers[i], numbers[i + 1], numbers[i + 2]);
  }
  return points;
}

v1::ModelEdge::CurveKind KindToProto(CurveKind kind) {
  switch (kind) {
    case CurveKind::kLine:
      return v1::ModelEdge::CURVE_KIND_LINE;
    case CurveKind::kCircle:
      return v1::ModelEdge::CURVE_KIND_CIRCLE;
    case CurveKind::kOther:
      break;
  }
  return v1::ModelEdge::CURVE_KIND_OTHER;
}

CurveKind KindFromProto(v1::ModelEdge::CurveKind kind) {
  if (kind == v1::ModelEdge::CURVE_KIND_LINE) return CurveKind::kLine;
  if (kind == v1::ModelEdge::CURVE_KIND_CIRCLE) return CurveKind::kCircle;
  return CurveKind::kOther;
}

}  // namespace

v1::RigidTransform ToProto(const Rigid3& transform) {
  Eigen::Quaterniond q(transform.R);
  q.normalize();
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  v1::RigidTransform out;
  out.mutable_rotation()->set_w(q.w());
  out.mutable_rotation()->set_x(q.x());
  out.mutable_rotation()->set_y(q.y());
  out.mutable_rotation()->set_z(q.z());
  out.mutable_translation_m()->set_x(transform.t.x());
  out.mutable_translation_m()->set_y(transform.t.y());
  out.mutable_translation_m()->set_z(transform.t.z());
  return out;
}

Eigen::Vector3d FromProto(const v1::Vector3& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

Rigid3 FromProto(const v1::RigidTransform& transform) {
  Rigid3 out;
  const auto& r = transform.rotation();
  const Eigen::Quaterniond q(r.w(), r.x(), r.y(), r.z());
  if (q.norm() > 0.0) out.R = q.normalized().toRotationMatrix();
  out.t = FromProto(transform.translation_m());
  return out;
}

v1::Grasp ToProto(const Grasp& grasp) {
  v1::Grasp out;
  out.set_name(ToUtf8(grasp.name));
  *out.mutable_object_from_gripper() = ToProto(grasp.object_from_gripper);
  if (IsSuction(grasp)) {
    out.mutable_suction()->set_cup_radius_m(CupRadius(grasp));
  } else {
    out.mutable_parallel_jaw()->set_jaw_opening_m(grasp.jaw_opening_m);
    out.mutable_parallel_jaw()->set_grip_width_m(grasp.grip_width_m);
  }
  out.set_quality(grasp.quality);
  if (grasp.object_from_pregrasp) {
    *out.mutable_object_from_pregrasp() = ToProto(*grasp.object_from_pregrasp);
  }
  return out;
}

v1::Object ToProto(const ObjectModel& model) {
  v1::Object out;
  out.set_display_name(ToUtf8(model.display_name));
  out.set_diameter_m(model.diameter_m);
  AppendPoints(model.vertices, out.mutable_vertices_m());
  for (const ModelEdge& e : model.edges) {
    v1::ModelEdge* edge = out.add_edges();
    edge->set_kind(KindToProto(e.kind));
    if (e.start_vertex >= 0) {
      edge->set_start_vertex(e.start_vertex);
      edge->set_end_vertex(e.end_vertex);
    }
    edge->set_dihedral_rad(e.dihedral_rad);
    AppendPoints(e.polyline, edge->mutable_polyline_m());
  }
  AppendPoints(model.mesh.vertices, out.mutable_mesh()->mutable_vertices_m());
  for (const Eigen::Vector3i& t : model.mesh.triangles) {
    for (int k = 0; k < 3; ++k) out.mutable_mesh()->add_triangles(t[k]);
  }
  for (const Rgba& color : model.mesh.colors) {
    out.mutable_mesh()->mutable_triangle_colors_rgba()->append(color.begin(), color.end());
  }
  for (const Rigid3& s : model.symmetries) {
    *out.add_object_from_symmetric_object() = ToProto(s);
  }
  for (const Grasp& g : model.grasps) *out.add_grasps() = ToProto(g);
  return out;
}

ObjectModel FromProto(const v1::Object& object) {
  ObjectModel model;
  model.id = IdOfResource(object.name());
  model.display_name = object.display_name();
  model.diameter_m = object.diameter_m();
  model.vertices = PointsOf(object.vertices_m());
  for (const v1::ModelEdge& e : object.edges()) {
    ModelEdge edge;
    edge.kind = KindFromProto(e.kind());
    edge.start_vertex = e.has_start_vertex() ? e.start_vertex() : -1;
    edge.end_vertex = e.has_end_vertex() ? e.end_vertex() : -1;
    edge.dihedral_rad = e.dihedral_rad();
    edge.polyline = PointsOf(e.polyline_m());
    if (edge.polyline.size() >= 2) model.edges.push_back(std::move(edge));
  }
  model.mesh.vertices = PointsOf(object.mesh().vertices_m());
  const auto& indices = object.mesh().triangles();
  const int n = static_cast<int>(model.mesh.vertices.size());
  const std::string& colors = object.mesh().triangle_colors_rgba();
  const bool colored = colors.size() * 3 == 4 * static_cast<size_t>(indices.size());
  for (int i = 0; i + 2 < indices.size(); i += 3) {
    const Eigen::Vector3i t(indices[i], indices[i + 1], indices[i + 2]);
    if (t.minCoeff() < 0 || t.maxCoeff() >= n) continue;
    model.mesh.triangles.push_back(t);
    if (!colored) continue;
    Rgba& color = model.mesh.colors.emplace_back();
    std::copy_n(colors.begin() + i / 3 * 4, 4, color.begin());
  }
  for (const auto& s : object.object_from_symmetric_object()) {
    model.symmetries.push_back(FromProto(s));
  }
  for (const v1::Grasp& g : object.grasps()) {
    Grasp grasp{g.name(),
                FromProto(g.object_from_gripper()),
                g.parallel_jaw().jaw_opening_m(),
                g.parallel_jaw().grip_width_m(),
                g.has_quality() ? g.quality() : 1.0,
                {}};
    if (g.has_suction()) SetSuction(g.suction().cup_radius_m(), &grasp);
    if (g.has_object_from_pregrasp()) {
      grasp.object_from_pregrasp = FromProto(g.object_from_pregrasp());
    }
    model.grasps.push_back(std::move(grasp));
  }
  return model;
}

std::string ResourceName(const std::string& given) {
  const std::string id = ToUtf8(given);
  return kNamePrefix + id;
}

std::string IdOfResource(const std::string& name) {
  return name.rfind(kNamePrefix, 0) == 0 ? name.substr(sizeof(kNamePrefix) - 1) : name;
}

}  // namespace horopter
