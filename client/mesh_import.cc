#include "client/mesh_import.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <exception>
#include <map>
#include <numeric>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cad_findings.h"
#include "client/cao_file.h"
#include "client/edge_chains.h"
#include "client/mesh_file.h"
#include "client/mesh_topology.h"
#include "client/reconstruction_file.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/mesh_decimation.h"
#include "server/vision/geometry/mesh_denoising.h"

namespace horopter {
namespace {

constexpr double kMeshWeldShare =
    1e-5;                              // of the bounding box diagonal: float coordinates of a part
constexpr double kCircleShare = 2e-4;  // rim points may lie this far off their circle
constexpr double kScanTurnRad = 25.0 * M_PI / 180.0;
constexpr double kScanCrease = 0.05;
constexpr double kScanTolerance = 3.0;  // deviations that lines and circles of a scan leave open
constexpr double kSmoothTurnRad = 25.0 * M_PI / 180.0;  // joints of a free-form edge

// The faces between the wireframe's edges; what bounds no two of them is told.
absl::StatusOr<TriangleMesh> Surface(const Wireframe& wireframe,
                                     const std::string& path,
                                     double metres_per_unit,
                                     double tolerance_share,
                                     CadImport& import) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : wireframe.points) box.extend(p);
  WireframeSurface surface = SurfaceOfWireframe(wireframe, tolerance_share * box.diagonal().norm());
  if (surface.mesh.triangles.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": the ", wireframe.edges.size(), " edges bound no plane face"));
  }
  if (surface.open_edges > 0) {
    import.warnings.push_back(absl::StrCat(
        surface.open_edges, " of ", wireframe.edges.size(), " edges do not bound two faces"));
  }
  for (Eigen::Vector3d& v : surface.mesh.vertices) v *= metres_per_unit;
  return std::move(surface.mesh);
}

TriangleMesh InMetres(TriangleMesh mesh, double metres_per_unit) {
  for (Eigen::Vector3d& v : mesh.vertices) v *= metres_per_unit;
  return mesh;
}

absl::StatusOr<TriangleMesh> ReadRangeImage(const std::string& path,
                                            const std::vector<Eigen::Vector3d>& points,
                                            CadImport& import) {
  const absl::StatusOr<RangeImageModel> model = ModelFromPoints(points);
  if (!model.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": point cloud: ", std::string(model.status().message())));
  }
  import.warnings.push_back(absl::StrCat("a point cloud of ",
                                         points.size(),
                                         " points: ",
                                         model->planes,
                                         " planes explain ",
                                         std::lround(100.0 * model->explained),
                                         " % of them"));
  constexpr double kCloudTolerance = 5e-3;  // corners of noisy planes
  return Surface(model->wireframe, path, import.metres_per_unit, kCloudTolerance, import);
}

// Fewer triangles for the same shape; what comes out of it is said.
TriangleMesh Simplified(const TriangleMesh& soup,
                        double diagonal,
                        int max_triangles,
                        CadImport* import) {
  constexpr double kCell = 1.0 / 250.0, kTolerance = 5e-4, kCoarse = 2e-3;  // diagonals
  IndexedMesh mesh = ClusterVertices({soup.vertices, soup.triangles}, kCell * diagonal);
  mesh = Decimate(std::move(mesh), {kTolerance * diagonal, max_triangles, kCoarse * diagonal});
  TriangleMesh out;
  out.vertices = std::move(mesh.vertices);
  out.triangles = std::move(mesh.triangles);
  AddFinding(CadFindingKind::kSimplified,
             absl::StrFormat("%d triangles; simplified to %d, within %.2f mm",
                             soup.triangles.size(),
                             out.triangles.size(),
                             kCell * diagonal * 1e3),
             import);
  return out;
}

// Region id per triangle: triangles joined over edges without an angle.
std::vector<int> PlanarRegions(const TriangleMesh& mesh, const std::vector<MeshEdge>& edges) {
  return TriangleRegions(mesh.triangles.size(), edges, [](const MeshEdge& e) {
    return e.dihedral_rad < kCoplanarRad;
  });
}

// Drops the edges between the wall facets of a coarse cylinder or cone: they start inside a rim (an
// arc run on the border of one plane) and fold no more than the rim turns.
std::vector<MeshEdge> DropWallEdges(const TriangleMesh& mesh,
                                    const std::vector<MeshEdge>& sharp,
                                    const std::vector<int>& region,
                                    double tolerance) {
  std::map<int, std::vector<std::pair<int, int>>> border;
  for (const MeshEdge& e : sharp) {
    border[region[e.triangle_1]].push_back({e.a, e.b});
    if (e.triangle_2 >= 0 && region[e.triangle_2] != region[e.triangle_1]) {
      border[region[e.triangle_2]].push_back({e.a, e.b});
    }
  }
  constexpr double kMargin = 0.035;   // 2 degrees
  std::map<int, double> turn_inside;  // rim vertex -> turn of its rim
  std::set<std::pair<int, int>> rim_edges;
  for (const auto& [id, edges] : border) {
    for (const ArcRun& run : FindArcRuns(mesh.vertices, edges, tolerance)) {
      for (size_t i = 0; i < run.vertices.size(); ++i) {
        const bool inside = run.closed() || (i > 0 && i + 1 < run.vertices.size());
        if (inside) {
          double& turn = turn_inside[run.vertices[i]];
          turn = std::max(turn, run.largest_turn_rad);
        }
        if (i > 0) rim_edges.insert(std::minmax(run.vertices[i - 1], run.vertices[i]));
      }
    }
  }
  const auto folds_with_rim = [&](int v, double dihedral) {
    const auto it = turn_inside.find(v);
    return it != turn_inside.end() && dihedral <= it->second + kMargin;
  };
  std::vector<MeshEdge> kept;
  for (const MeshEdge& e : sharp) {
    const bool wall = !rim_edges.contains({e.a, e.b}) &&
                      (folds_with_rim(e.a, e.dihedral_rad) || folds_with_rim(e.b, e.dihedral_rad));
    if (!wall) kept.push_back(e);
  }
  return kept;
}

// Of a scan the edges where the surface beneath its noise turns, of those that hang together as far
// as kScanCrease of the diagonal and turn by kScanTurnRad somewhere.
std::vector<MeshEdge> ScanCreases(const DenoisedSurface& surface,
                                  double sharp_angle_rad,
                                  double diagonal) {
  std::vector<MeshEdge> edges = MeshEdges(surface.mesh);
  for (MeshEdge& e : edges) {
    if (e.triangle_2 < 0) continue;
    const Eigen::Vector3d &n1 = surface.normals[e.triangle_1], &n2 = surface.normals[e.triangle_2];
    e.dihedral_rad = std::atan2(n1.cross(n2).norm(), n1.dot(n2));
  }
  std::erase_if(edges, [&](const MeshEdge& e) { return e.dihedral_rad < sharp_angle_rad; });
  std::vector<int> parent(surface.mesh.vertices.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (const MeshEdge& e : edges) parent[root(e.a)] = root(e.b);
  struct Crease {
    Eigen::AlignedBox3d box;
    double turn_rad = 0.0;
  };
  std::map<int, Crease> creases;
  for (const MeshEdge& e : edges) {
    Crease& crease = creases[root(e.a)];
    for (const int v : {e.a, e.b}) crease.box.extend(surface.mesh.vertices[v]);
    crease.turn_rad = std::max(crease.turn_rad, e.dihedral_rad);
  }
  std::erase_if(edges, [&](const MeshEdge& e) {
    const Crease& crease = creases[root(e.a)];
    return crease.turn_rad < kScanTurnRad || crease.box.diagonal().norm() < kScanCrease * diagonal;
  });
  return edges;
}

ModelEdge StraightEdge(const ObjectModel& model, int a, int b, double dihedral) {
  return {CurveKind::kLine, a, b, dihedral, {model.vertices[a], model.vertices[b]}};
}

// One edge from a run of vertices of the mesh.
ModelEdge CurvedEdge(const ObjectModel& model,
                     const std::vector<int>& run,
                     CurveKind kind,
                     const std::map<std::pair<int, int>, double>& dihedral) {
  ModelEdge edge;
  edge.kind = kind;
  for (size_t i = 0; i < run.size(); ++i) {
    edge.polyline.push_back(model.vertices[run[i]]);
    if (i > 0) {
      edge.dihedral_rad +=
          dihedral.at(std::minmax(run[i - 1], run[i])) / static_cast<double>(run.size() - 1);
    }
  }
  if (run.front() != run.back()) {
    edge.start_vertex = run.front();
    edge.end_vertex = run.back();
  }
  return edge;
}

// Joins the straight pieces of a free-form edge (three or more, each joint turning a little) into
// kOther curves.
void JoinFreeForm(ObjectModel& model) {
  std::map<int, std::vector<int>> incident;
  for (int e = 0; e < static_cast<int>(model.edges.size()); ++e) {
    if (model.edges[e].start_vertex < 0) continue;
    incident[model.edges[e].start_vertex].push_back(e);
    incident[model.edges[e].end_vertex].push_back(e);
  }
  const auto other_end = [&](int e, int v) {
    return model.edges[e].start_vertex == v ? model.edges[e].end_vertex
                                            : model.edges[e].start_vertex;
  };
  const auto passes = [&](int v) {
    const auto& list = incident[v];
    if (list.size() != 2 || list[0] == list[1]) return false;
    for (const int e : list) {
      if (model.edges[e].kind != CurveKind::kLine) return false;
    }
    const Eigen::Vector3d p = model.vertices[v];
    const Eigen::Vector3d u = p - model.vertices[other_end(list[0], v)];
    const Eigen::Vector3d w = model.vertices[other_end(list[1], v)] - p;
    return std::atan2(u.cross(w).norm(), u.dot(w)) <= kSmoothTurnRad &&
           std::max(u.norm(), w.norm()) <= 3.0 * std::min(u.norm(), w.norm());
  };
  std::vector<bool> used(model.edges.size(), false);
  std::vector<ModelEdge> result;
  const auto walk = [&](int e, int v) {
    std::vector<int> vertices{v}, pieces;
    while (e >= 0) {
      used[e] = true;
      pieces.push_back(e);
      v = other_end(e, v);
      vertices.push_back(v);
      if (!passes(v)) break;
      const auto& list = incident[v];
      const int next = list[0] == e ? list[1] : list[0];
      e = used[next] ? -1 : next;
    }
    if (pieces.size() < 3) {
      for (const int piece : pieces) result.push_back(model.edges[piece]);
      return;
    }
    std::map<std::pair<int, int>, double> dihedral;
    for (size_t i = 0; i < pieces.size(); ++i) {
      dihedral[std::minmax(vertices[i], vertices[i + 1])] = model.edges[pieces[i]].dihedral_rad;
    }
    result.push_back(CurvedEdge(model, vertices, CurveKind::kOther, dihedral));
  };
  for (const auto& [v, list] : incident) {
    if (passes(v)) continue;
    for (const int e : list) {
      if (!used[e]) walk(e, v);
    }
  }
  for (int e = 0; e < static_cast<int>(model.edges.size()); ++e) {
    if (used[e]) continue;
    if (model.edges[e].start_vertex < 0) {
      result.push_back(model.edges[e]);
    } else {
      walk(e, model.edges[e].start_vertex);
    }
  }
  model.edges = std::move(result);
}

// Lines, circles and curves from edges of a mesh over model.vertices.
void BuildEdges(const std::vector<MeshEdge>& edges, double tolerance, ObjectModel& model) {
  std::map<std::pair<int, int>, double> dihedral;
  std::vector<std::pair<int, int>> pairs;
  for (const MeshEdge& e : edges) {
    dihedral[{e.a, e.b}] = e.dihedral_rad;
    pairs.push_back({e.a, e.b});
  }
  std::set<std::pair<int, int>> in_arc;
  for (const ArcRun& run : FindArcRuns(model.vertices, pairs, tolerance)) {
    model.edges.push_back(CurvedEdge(model, run.vertices, CurveKind::kCircle, dihedral));
    for (size_t i = 1; i < run.vertices.size(); ++i) {
      in_arc.insert(std::minmax(run.vertices[i - 1], run.vertices[i]));
    }
  }
  for (const auto& [a, b] : pairs) {
    if (!in_arc.contains({a, b})) {
      model.edges.push_back(StraightEdge(model, a, b, dihedral.at({a, b})));
    }
  }
  MergeSmoothJoints(model, 0.5 * tolerance);
  JoinFreeForm(model);
  DropUnusedVertices(model);
}

// What the file says of itself, else what the caller says, else what is usual for its format.
// Errors: INVALID_ARGUMENT, both differ or the unit is unknown.
absl::Status ChooseUnit(const std::string& path,
                        const std::string& of_file,
                        const CadImportOptions& options,
                        const std::string& usual,
                        CadImport* import) {
  import->unit_from_file = !of_file.empty();
  if (import->unit_from_file && !options.unit.empty() &&
      MetresPerUnit(options.unit) != MetresPerUnit(of_file)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "units: ", path, " is in ", of_file, " by its own word, not in ", options.unit));
  }
  import->unit_name = import->unit_from_file  ? of_file
                      : !options.unit.empty() ? options.unit
                                              : usual;
  import->metres_per_unit = MetresPerUnit(import->unit_name);
  if (import->metres_per_unit <= 0.0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "units: ", path, ": unknown unit '", import->unit_name, "' (use mm, cm, m, in, ft or um)"));
  }
  return absl::OkStatus();
}

// told_faces: the file says which side of a face is outside.
void TellRepairs(const CleanMesh& clean, bool told_faces, CadImport* import) {
  if (clean.turned_triangles > 0 && told_faces) {
    AddFinding(CadFindingKind::kInvertedFaces,
               absl::StrCat(clean.turned_triangles, " triangles pointed inwards; turned"),
               import);
  }
  if (clean.duplicate_triangles > 0) {
    AddFinding(CadFindingKind::kDuplicateFaces,
               absl::StrCat(clean.duplicate_triangles, " triangles were there twice; dropped"),
               import);
  }
  if (clean.degenerate_triangles > 0) {
    import->warnings.push_back(
        absl::StrCat(clean.degenerate_triangles, " degenerate triangles dropped"));
  }
}

// Of a scan what is kept is told.
void FindEdges(double diagonal, double sharp_angle_rad, CadImport* import) {
  ObjectModel& model = import->model;
  const std::vector<MeshEdge> all = MeshEdges(model.mesh);
  std::vector<MeshEdge> sharp = all;
  std::erase_if(sharp, [&](const MeshEdge& e) { return e.dihedral_rad < sharp_angle_rad; });
  const SurfaceNoise noise = MeasureSurfaceNoise(model.mesh);
  if (!IsScan(noise)) {
    const double tolerance = kCircleShare * diagonal;
    model.vertices = model.mesh.vertices;
    BuildEdges(DropWallEdges(model.mesh, sharp, PlanarRegions(model.mesh, all), tolerance),
               tolerance,
               model);
    return;
  }
  DenoisedSurface surface = Denoise(model.mesh, noise);
  const std::vector<MeshEdge> creases = ScanCreases(surface, sharp_angle_rad, diagonal);
  model.vertices = std::move(surface.mesh.vertices);
  BuildEdges(creases, kScanTolerance * noise.deviation, model);
  AddFinding(CadFindingKind::kScan,
             absl::StrFormat("a scanned surface, %.2f mm rough: of %d edges of the mesh that turn "
                             "by %.0f degrees %d are kept, on creases of the part; what is smooth "
                             "is found by its outline",
                             noise.deviation * 1e3,
                             sharp.size(),
                             sharp_angle_rad * 180.0 / M_PI,
                             creases.size()),
             import);
}

}  // namespace

absl::Status FillFromTriangles(const std::string& path,
                               const TriangleMesh& triangles,
                               bool told_faces,
                               const CadImportOptions& options,
                               CadImport* import) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3i& t : triangles.triangles) {
    for (const int k : t) box.extend(triangles.vertices[k]);
  }
  const double diagonal = box.diagonal().norm();
  const bool many = static_cast<int>(triangles.triangles.size()) > options.max_triangles;
  CleanMesh clean = CleanTriangleSoup(
      many ? Simplified(triangles, diagonal, options.max_triangles, import) : triangles,
      kMeshWeldShare * diagonal);
  if (clean.mesh.triangles.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": all triangles are degenerate"));
  }
  TellRepairs(clean, told_faces, import);
  import->model.mesh = std::move(clean.mesh);
  FindEdges(diagonal, options.sharp_angle_rad, import);
  return absl::OkStatus();
}

absl::StatusOr<CadImport> ImportMesh(const std::string& path, const CadImportOptions& options) {
  CadImport import;
  ReconstructionFile reconstruction;
  const bool wireframe = absl::EndsWithIgnoreCase(path, ".json");
  if (wireframe) {
    HOROPTER_ASSIGN_OR_RETURN(reconstruction, ReadReconstruction(path));
  }
  const bool cao = absl::EndsWithIgnoreCase(path, ".cao");
  MeshFile file;
  try {
    if (!wireframe && !cao) {
      HOROPTER_ASSIGN_OR_RETURN(file, ReadMeshFile(path));
    }
    const std::string& unit = wireframe ? reconstruction.unit : file.unit;
    HOROPTER_RETURN_IF_ERROR(ChooseUnit(path, unit, options, cao ? "m" : file.usual_unit, &import));
    import.warnings = file.notes;
    const bool cloud = file.mesh.triangles.empty() && !file.mesh.vertices.empty();
    constexpr double kReconstructionTolerance = 3e-3;  // corners, as a share of the extent
    HOROPTER_ASSIGN_OR_RETURN(TriangleMesh soup,
                              wireframe ? Surface(reconstruction.wireframe,
                                                  path,
                                                  import.metres_per_unit,
                                                  kReconstructionTolerance,
                                                  import)
                              : cao     ? ReadCao(path, import.metres_per_unit)
                              : cloud   ? ReadRangeImage(path, file.mesh.vertices, import)
                                        : InMetres(std::move(file.mesh), import.metres_per_unit));
    // Faces made here have no side of their own.
    const bool told_faces = !wireframe && !cao && !cloud;
    HOROPTER_RETURN_IF_ERROR(FillFromTriangles(path, soup, told_faces, options, &import));
  } catch (const std::exception& e) {  // the allocator, on hostile files
    return absl::InvalidArgumentError(absl::StrCat(path, ": cannot be read: ", e.what()));
  }
  return import;
}

}  // namespace horopter
