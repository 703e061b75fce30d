#include "tests/support/sample_record.h"

#include <Eigen/Geometry>
#include <cmath>

namespace horopter {
namespace {

Rigid3 RandomRigid(std::mt19937& rng) {
  std::normal_distribution<double> normal;
  const Eigen::Quaterniond q(normal(rng), normal(rng), normal(rng), normal(rng));
  return {q.normalized().toRotationMatrix(), {normal(rng), normal(rng), normal(rng)}};
}

bool Same(const Rigid3& a, const Rigid3& b) {
  return a.R == b.R && a.t == b.t;
}

void AddBox(const Eigen::Vector3d& half, ObjectModel& model) {
  for (int i = 0; i < 8; ++i) {
    model.vertices.emplace_back(
        i & 1 ? half.x() : -half.x(), i & 2 ? half.y() : -half.y(), i & 4 ? half.z() : -half.z());
  }
  for (int i = 0; i < 8; ++i) {
    for (const int bit : {1, 2, 4}) {
      const int j = i | bit;
      if (j == i) continue;
      model.edges.push_back(
          {CurveKind::kLine, i, j, M_PI / 2, {model.vertices[i], model.vertices[j]}});
    }
  }
  model.mesh.vertices = model.vertices;
  const int faces[6][4] = {
      {0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& f : faces) {
    model.mesh.triangles.emplace_back(f[0], f[1], f[2]);
    model.mesh.triangles.emplace_back(f[0], f[2], f[3]);
    for (int k = 0; k < 2; ++k) {
      model.mesh.colors.push_back({static_cast<std::uint8_t>(30 * f[1]), 200, 17, 255});
    }
  }
  model.mesh.colors[3] = kNoColor;
}

}  // namespace

CatalogRecord SampleRecord(const std::string& id, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> size(0.01, 0.05);
  CatalogRecord record;
  ObjectModel& model = record.model;
  model.id = id;
  model.display_name = "Kasten \xc3\xbc mit Loch";
  const Eigen::Vector3d half(size(rng), size(rng), size(rng));
  AddBox(half, model);
  ModelEdge circle{CurveKind::kCircle, -1, -1, 1.25, {}};
  constexpr int kSegments = 24;
  for (int i = 0; i <= kSegments; ++i) {
    const double angle = 2 * M_PI * (i % kSegments) / kSegments;
    circle.polyline.emplace_back(0.005 * std::cos(angle), 0.005 * std::sin(angle), half.z());
  }
  model.edges.push_back(circle);
  model.diameter_m = 2 * half.norm();
  Rigid3 half_turn;
  half_turn.R = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  model.symmetries.push_back(half_turn);
  model.grasps.push_back({"top", RandomRigid(rng), 0.06, 0.04, 0.5, {}});
  model.grasps.push_back({"side", RandomRigid(rng), 0.03, 0.0125, 1.0, RandomRigid(rng)});
  record.source.file_name = "box.step";
  record.source.format = "step";
  record.source.unit = "mm";
  record.source.content = std::string("ISO-10303-21;\0\xff\n", 16) + std::to_string(seed);
  record.source.size_bytes = static_cast<int64_t>(record.source.content.size());
  record.labels["material"] = "steel " + std::to_string(seed);
  record.create_time = "2024-01-02T03:04:05Z";
  record.update_time = "2024-01-02T03:04:05.250Z";
  return record;
}

bool SamePrint(const SurfacePrint& a, const SurfacePrint& b) {
  return a.views == b.views && std::equal(a.places.begin(),
                                          a.places.end(),
                                          b.places.begin(),
                                          b.places.end(),
                                          [](const PrintPlace& p, const PrintPlace& q) {
                                            return p.point == q.point && p.normal == q.normal &&
                                                   p.brightness == q.brightness;
                                          });
}

std::string FirstDifference(const CatalogRecord& a, const CatalogRecord& b) {
  const ObjectModel &m = a.model, &n = b.model;
  if (m.id != n.id) return "id";
  if (m.display_name != n.display_name) return "display_name";
  if (m.diameter_m != n.diameter_m) return "diameter";
  if (m.vertices != n.vertices) return "vertices";
  if (m.edges.size() != n.edges.size()) return "edge count";
  for (size_t i = 0; i < m.edges.size(); ++i) {
    const ModelEdge &e = m.edges[i], &f = n.edges[i];
    if (e.kind != f.kind || e.start_vertex != f.start_vertex || e.end_vertex != f.end_vertex ||
        e.dihedral_rad != f.dihedral_rad || e.polyline != f.polyline) {
      return "edge " + std::to_string(i);
    }
  }
  if (m.mesh.vertices != n.mesh.vertices || m.mesh.triangles != n.mesh.triangles) return "mesh";
  if (m.mesh.colors != n.mesh.colors) return "mesh colours";
  if (m.symmetries.size() != n.symmetries.size()) return "symmetry count";
  for (size_t i = 0; i < m.symmetries.size(); ++i) {
    if (!Same(m.symmetries[i], n.symmetries[i])) return "symmetry " + std::to_string(i);
  }
  if (m.grasps.size() != n.grasps.size()) return "grasp count";
  for (size_t i = 0; i < m.grasps.size(); ++i) {
    const Grasp &g = m.grasps[i], &h = n.grasps[i];
    if (g.name != h.name || !Same(g.object_from_gripper, h.object_from_gripper) ||
        g.jaw_opening_m != h.jaw_opening_m || g.grip_width_m != h.grip_width_m ||
        g.quality != h.quality ||
        g.object_from_pregrasp.has_value() != h.object_from_pregrasp.has_value() ||
        (g.object_from_pregrasp && !Same(*g.object_from_pregrasp, *h.object_from_pregrasp))) {
      return "grasp " + std::to_string(i);
    }
  }
  if (a.source.file_name != b.source.file_name || a.source.format != b.source.format ||
      a.source.unit != b.source.unit || a.source.size_bytes != b.source.size_bytes) {
    return "source";
  }
  if (a.labels != b.labels) return "labels";
  if (!SamePrint(m.print, n.print)) return "print";
  if (a.create_time != b.create_time) return "create_time";
  if (a.update_time != b.update_time) return "update_time";
  return "";
}

bool NearlyEqual(const Rigid3& a, const Rigid3& b, double tolerance) {
  return (a.R - b.R).cwiseAbs().maxCoeff() <= tolerance &&
         (a.t - b.t).cwiseAbs().maxCoeff() <= tolerance;
}

}  // namespace horopter
