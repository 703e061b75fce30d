#include "client/cad_findings.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/mesh_topology.h"

namespace horopter {
namespace {

constexpr double kThinShare = 0.03;                      // thickness of a plate, diameters
constexpr double kLikelyFromM = 0.01, kLikelyToM = 1.0;  // sizes of parts that robots handle

bool IsNote(CadFindingKind kind) {
  return kind == CadFindingKind::kNoSharpEdges || kind == CadFindingKind::kNoOrientation ||
         kind == CadFindingKind::kPlainPlate || kind == CadFindingKind::kNearlySymmetric ||
         kind == CadFindingKind::kScan;
}

std::string PlaceMm(const Eigen::Vector3d& p) {
  return absl::StrFormat("(%.1f, %.1f, %.1f) mm", p.x() * 1e3, p.y() * 1e3, p.z() * 1e3);
}

std::string AxisText(const Eigen::Vector3d& a) {
  return absl::StrFormat("(%.2f, %.2f, %.2f)", a.x(), a.y(), a.z());
}

struct Body {
  double volume = 0.0;
  bool closed = true;
  Eigen::AlignedBox3d box;
  int triangles = 0;
};

std::vector<Body> BodiesOf(const TriangleMesh& mesh, const std::vector<MeshEdge>& edges) {
  const std::vector<int> body_of =
      TriangleRegions(mesh.triangles.size(), edges, [](const MeshEdge&) { return true; });
  std::map<int, Body> bodies;
  for (int t = 0; t < static_cast<int>(body_of.size()); ++t) {
    const Eigen::Vector3i& v = mesh.triangles[t];
    Body& body = bodies[body_of[t]];
    ++body.triangles;
    body.volume += mesh.vertices[v[0]].dot(mesh.vertices[v[1]].cross(mesh.vertices[v[2]])) / 6.0;
    for (const int k : v) body.box.extend(mesh.vertices[k]);
  }
  for (const MeshEdge& e : edges) {
    if (e.triangle_2 < 0) bodies[body_of[e.triangle_1]].closed = false;
  }
  std::vector<Body> out;
  for (auto& [id, body] : bodies) out.push_back(body);
  return out;
}

void FindBorders(const std::vector<MeshEdge>& edges, CadImport* import) {
  const TriangleMesh& mesh = import->model.mesh;
  int borders = 0;
  double length = 0.0;
  Eigen::AlignedBox3d box;
  for (const MeshEdge& e : edges) {
    if (e.triangle_2 >= 0) continue;
    ++borders;
    length += (mesh.vertices[e.a] - mesh.vertices[e.b]).norm();
    box.extend(mesh.vertices[e.a]);
    box.extend(mesh.vertices[e.b]);
  }
  const auto crowded =
      std::count_if(edges.begin(), edges.end(), [](const auto& e) { return e.triangles > 2; });
  if (crowded > 0) {
    AddFinding(
        CadFindingKind::kOpenMesh,
        absl::StrFormat("the mesh is not closed: at %d edges more than two faces meet", crowded),
        import);
  }
  if (borders == 0) return;
  AddFinding(CadFindingKind::kOpenMesh,
             absl::StrFormat("the mesh is not closed: %d open edges, %.1f mm of border, about %s",
                             borders,
                             length * 1e3,
                             PlaceMm(box.center())),
             import);
}

void FindBodies(const std::vector<MeshEdge>& edges, CadImport* import) {
  const std::vector<Body> bodies = BodiesOf(import->model.mesh, edges);
  int outer = 0, inner = 0, hidden_triangles = 0;
  double smallest = import->model.diameter_m;
  for (const Body& b : bodies) {
    const bool inside =
        b.closed && std::any_of(bodies.begin(), bodies.end(), [&](const Body& o) {
          return &o != &b && o.closed && o.volume > std::abs(b.volume) && o.box.contains(b.box);
        });
    if (inside && b.volume < 0.0) {
      ++inner;
      hidden_triangles += b.triangles;
    } else {
      ++outer;
      smallest = std::min(smallest, b.box.diagonal().norm());
    }
  }
  if (inner > 0) {
    AddFinding(CadFindingKind::kHiddenInside,
               absl::StrFormat("%d closed cavities of %d triangles that no camera sees: parts that "
                               "differ only there are one part to recognition",
                               inner,
                               hidden_triangles),
               import);
  }
  const bool known =
      std::any_of(import->findings.begin(), import->findings.end(), [](const auto& f) {
        return f.kind == CadFindingKind::kSeveralBodies;
      });
  if (outer > 1 && !known) {
    AddFinding(CadFindingKind::kSeveralBodies,
               absl::StrFormat("%d separate bodies, the smallest of %.1f mm; taken as one rigid "
                               "part: what moves or may be missing does not belong in it",
                               outer,
                               smallest * 1e3),
               import);
  }
}

void FindSymmetries(const MeshSymmetryOptions& options, CadImport* import) {
  const ObjectModel& model = import->model;
  import->symmetries = FindMeshSymmetries(model.mesh, model.diameter_m, options);
  if (import->symmetries.sphere) {
    AddFinding(CadFindingKind::kNoOrientation,
               "a sphere: it has no orientation, any will be answered",
               import);
    return;
  }
  for (const NearSymmetry& near : import->symmetries.near) {
    AddFinding(CadFindingKind::kNearlySymmetric, Describe(near), import);
  }
}

// Thin, flat, and the same when it is turned over.
void FindPlainPlate(CadImport* import) {
  const ObjectModel& model = import->model;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& v : model.mesh.vertices) {
    mean += v / static_cast<double>(model.mesh.vertices.size());
  }
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  for (const auto& v : model.mesh.vertices) moment += (v - mean) * (v - mean).transpose();
  const Eigen::Vector3d normal =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(moment).eigenvectors().col(0);
  double low = 0.0, high = 0.0;
  for (const auto& v : model.mesh.vertices) {
    low = std::min(low, normal.dot(v - mean));
    high = std::max(high, normal.dot(v - mean));
  }
  if (high - low > kThinShare * model.diameter_m) return;
  const auto turns_over = [&](const SymmetryAxis& a) {
    return a.order != 0 && a.order % 2 == 0 && std::abs(a.axis.dot(normal)) < 0.05;
  };
  const MeshSymmetries& s = import->symmetries;
  if (!std::any_of(s.exact.begin(), s.exact.end(), turns_over) &&
      !std::any_of(
          s.near.begin(), s.near.end(), [&](const auto& n) { return turns_over(n.axis); })) {
    return;
  }
  AddFinding(
      CadFindingKind::kPlainPlate,
      absl::StrFormat("a plate of %.2f mm without relief: its outline alone is seen, and not "
                      "which side is up",
                      (high - low) * 1e3),
      import);
}

// Another unit that gives a likely size where the assumed one does not.
std::string LikelierUnits(const CadImport& import) {
  std::string out;
  const double in_file = import.model.diameter_m / import.metres_per_unit;
  for (const char* unit : {"mm", "cm", "m", "in"}) {
    const double metres = in_file * MetresPerUnit(unit);
    if (unit == import.unit_name || metres < kLikelyFromM || metres > kLikelyToM) continue;
    absl::StrAppend(&out,
                    out.empty() ? "" : ", ",
                    absl::StrFormat("%.1f mm with --units %s", metres * 1e3, unit));
  }
  return out;
}

}  // namespace

void AddFinding(CadFindingKind kind, std::string text, CadImport* import) {
  if (!IsNote(kind)) import->warnings.push_back(text);
  import->findings.push_back({kind, std::move(text)});
}

void FindOddities(const MeshSymmetryOptions& options, CadImport* import) {
  const std::vector<MeshEdge> edges = MeshEdges(import->model.mesh);
  FindBorders(edges, import);
  FindBodies(edges, import);
  if (import->model.edges.empty()) {
    AddFinding(
        CadFindingKind::kNoSharpEdges, "no sharp edges: it is found by its outline alone", import);
  }
  FindSymmetries(options, import);
  FindPlainPlate(import);
  if (!import->unit_from_file && import->model.diameter_m < kLikelyFromM) {
    const std::string likelier = LikelierUnits(*import);
    if (!likelier.empty()) {
      AddFinding(CadFindingKind::kDoubtfulUnit,
                 absl::StrFormat("diameter %.2f mm with the assumed unit %s; it would be %s",
                                 import->model.diameter_m * 1e3,
                                 import->unit_name,
                                 likelier),
                 import);
    }
  }
}

std::string SuggestUnits(const CadImport& import) {
  const std::string likelier = LikelierUnits(import);
  return likelier.empty() ? "" : absl::StrCat("; it would be ", likelier);
}

std::string Describe(const NearSymmetry& near) {
  const SurfaceMismatch& m = near.mismatch;
  const std::string turn = near.axis.order == 0
                               ? std::string("by any angle")
                               : absl::StrFormat("by %.1f degrees", 360.0 / near.axis.order);
  return absl::StrFormat(
      "turned %s about the axis %s it is the same but for %.1f mm about %s, off by %.2f mm (%.1f "
      "%% "
      "of the surface): images that do not show this leave the turn open",
      turn,
      AxisText(near.axis.axis),
      m.size_m * 1e3,
      PlaceMm(m.place),
      m.largest_m * 1e3,
      m.area_share * 100.0);
}

std::string DescribeMismatch(const Rigid3& declared, const SurfaceMismatch& m) {
  const Eigen::AngleAxisd turn(declared.R);
  return absl::StrFormat(
      "the declared turn by %.1f degrees about the axis %s leaves the surface off by up to %.2f "
      "mm, "
      "over %.1f mm about %s",
      turn.angle() * 180.0 / M_PI,
      AxisText(turn.axis()),
      m.largest_m * 1e3,
      m.size_m * 1e3,
      PlaceMm(m.place));
}

}  // namespace horopter
