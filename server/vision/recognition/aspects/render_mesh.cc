#include "server/vision/recognition/aspects/render_mesh.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/vision/geometry/mesh_decimation.h"

namespace horopter {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;
using Eigen::Vector3i;

constexpr double kGridSteps = 65535.0;  // along the longest side: 16 bits
// Larger meshes are clustered first, on a grid of this share of the diameter: less than a pixel of
// a rendering of 200 px, and some 200000 cells of a compact part's surface.
constexpr std::size_t kManyTriangles = 300000;
constexpr float kFlatCosine = 0.9998f;        // one degree
constexpr double kClusterCell = 1.0 / 250.0;  // of the diameter

struct Box {
  Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity());
  Vector3d high = -low;
  Vector3d size() const { return high - low; }
};

absl::StatusOr<Box> MeshBox(const TriangleMesh& mesh) {
  const int count = static_cast<int>(mesh.vertices.size());
  Box box;
  for (const Vector3i& t : mesh.triangles) {
    for (const int v : t) {
      if (v < 0 || v >= count) {
        return absl::InvalidArgumentError(
            absl::StrCat("mesh: index ", v, " of ", count, " vertices"));
      }
      if (!mesh.vertices[v].allFinite()) {
        return absl::InvalidArgumentError(absl::StrCat("mesh: vertex ", v, " is not finite"));
      }
      box.low = box.low.cwiseMin(mesh.vertices[v]);
      box.high = box.high.cwiseMax(mesh.vertices[v]);
    }
  }
  if (mesh.triangles.empty() || !(box.size().maxCoeff() > 0.0)) {
    return absl::InvalidArgumentError("mesh: no triangle of positive area");
  }
  return box;
}

// Whole steps of the grid, packed.
std::uint64_t GridKey(const Vector3d& p, const Box& box, double step) {
  const Vector3d k = ((p - box.low) / step).array().round();
  return static_cast<std::uint64_t>(k.x()) | static_cast<std::uint64_t>(k.y()) << 16 |
         static_cast<std::uint64_t>(k.z()) << 32;
}

Vector3d FromKey(std::uint64_t key, const Box& box, double step) {
  return box.low + step * Vector3d(static_cast<double>(key & 0xffff),
                                   static_cast<double>(key >> 16 & 0xffff),
                                   static_cast<double>(key >> 32));
}

// Each triple of vertices once. Slivers without area stay: without them a closed mesh had gaps.
std::vector<Vector3i> CleanTriangles(const std::vector<Vector3i>& triangles) {
  std::vector<Vector3i> out;
  absl::flat_hash_set<std::pair<std::uint64_t, int>> seen;
  for (const Vector3i& t : triangles) {
    std::array<int, 3> v = {t[0], t[1], t[2]};
    std::sort(v.begin(), v.end());
    if (v[0] == v[1] || v[1] == v[2]) continue;
    const auto low = static_cast<std::uint64_t>(v[0]) << 32 | static_cast<std::uint32_t>(v[1]);
    if (seen.emplace(low, v[2]).second) out.push_back(t);
  }
  return out;
}

// Vertices on the same step of the grid are one.
IndexedMesh Weld(const IndexedMesh& mesh, const Box& box, double step) {
  IndexedMesh out;
  absl::flat_hash_map<std::uint64_t, int> index;
  std::vector<int> welded(mesh.vertices.size(), -1);
  std::vector<Vector3i> triangles = mesh.triangles;
  for (Vector3i& t : triangles) {
    for (int& v : t) {
      if (welded[v] < 0) {
        const std::uint64_t key = GridKey(mesh.vertices[v], box, step);
        const auto [it, added] = index.try_emplace(key, static_cast<int>(out.vertices.size()));
        if (added) out.vertices.push_back(mesh.vertices[v]);
        welded[v] = it->second;
      }
      v = welded[v];
    }
  }
  out.triangles = CleanTriangles(triangles);
  return out;
}

bool HasArea(const IndexedMesh& mesh) {
  return std::any_of(mesh.triangles.begin(), mesh.triangles.end(), [&](const Vector3i& t) {
    const Vector3d& a = mesh.vertices[t[0]];
    return (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).norm() > 0.0;
  });
}

// Triangles connected through edges, by the smallest index of a triangle of theirs.
std::vector<int> MeshComponents(const RenderMesh& mesh) {
  std::vector<int> parent(mesh.triangles.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int t) {
    while (parent[t] != t) t = parent[t] = parent[parent[t]];
    return t;
  };
  for (const RenderMeshEdge& e : mesh.edges) {
    if (e.right < 0) continue;
    const int a = root(e.left), b = root(e.right);
    parent[std::max(a, b)] = std::min(a, b);
  }
  for (int t = 0; t < static_cast<int>(parent.size()); ++t) parent[t] = root(t);
  return parent;
}

// True if the surface has no border: every edge is run through as often one way as the other.
bool FillEdges(RenderMesh* mesh) {
  struct Side {
    int triangle;
    bool forward;  // from the smaller vertex to the larger one
  };
  struct Sides {
    std::uint64_t key;
    Side side;
  };
  std::vector<Sides> sides;
  sides.reserve(3 * mesh->triangles.size());
  for (int t = 0; t < static_cast<int>(mesh->triangles.size()); ++t) {
    for (int k = 0; k < 3; ++k) {
      const int a = mesh->triangles[t][k], b = mesh->triangles[t][(k + 1) % 3];
      const auto key = static_cast<std::uint64_t>(std::min(a, b)) << 32 |
                       static_cast<std::uint32_t>(std::max(a, b));
      sides.push_back({key, {t, a < b}});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const Sides& x, const Sides& y) {
    return x.key != y.key ? x.key < y.key : x.side.triangle < y.side.triangle;
  });
  mesh->edges.clear();
  bool borderless = true;
  for (std::size_t i = 0, j = 0; i < sides.size(); i = j) {
    int balance = 0;
    for (; j < sides.size() && sides[j].key == sides[i].key; ++j) {
      balance += sides[j].side.forward ? 1 : -1;
    }
    borderless = borderless && balance == 0;
    RenderMeshEdge edge;
    edge.a = static_cast<std::int32_t>(sides[i].key >> 32);
    edge.b = static_cast<std::int32_t>(sides[i].key & 0xffffffff);
    edge.left = sides[i].side.triangle;
    if (j - i == 2) {
      edge.right = sides[i + 1].side.triangle;
      edge.same_winding = sides[i].side.forward == sides[i + 1].side.forward;
    }
    mesh->edges.push_back(edge);
  }
  return borderless;
}

struct Component {
  double volume = 0.0;
  Eigen::AlignedBox3f box;
};

// Of a mesh without border: whether every component is outside out, or a cavity of one that is. If
// all are inside out, they are turned.
bool MakeOutward(RenderMesh* mesh) {
  const std::vector<int> roots = MeshComponents(*mesh);
  std::map<int, Component> components;
  for (std::size_t t = 0; t < roots.size(); ++t) {
    const Vector3i& v = mesh->triangles[t];
    Component& c = components[roots[t]];
    const auto at = [&](int k) -> Vector3d {
      return (mesh->vertices[v[k]] - mesh->center).cast<double>();
    };
    c.volume += at(0).dot(at(1).cross(at(2)));
    for (const int k : v) c.box.extend(mesh->vertices[k]);
  }
  const bool inward = std::all_of(
      components.begin(), components.end(), [](const auto& c) { return c.second.volume <= 0.0; });
  if (inward) {
    for (Vector3i& t : mesh->triangles) std::swap(t[1], t[2]);
    return true;
  }
  return std::all_of(components.begin(), components.end(), [&](const auto& c) {
    return c.second.volume > 0.0 ||
           std::any_of(components.begin(), components.end(), [&](const auto& other) {
             return other.second.volume > 0.0 && other.second.box.contains(c.second.box);
           });
  });
}

double CornerAngle(const RenderMesh& mesh, int t, int k) {
  const Vector3i& v = mesh.triangles[t];
  const Vector3f a = mesh.vertices[v[(k + 1) % 3]] - mesh.vertices[v[k]];
  const Vector3f b = mesh.vertices[v[(k + 2) % 3]] - mesh.vertices[v[k]];
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// Means over the facets around a vertex that are smooth with the corner's own, weighted by area and
// angle: where a fillet meets a plane, the plane decides.
void FillNormals(double smooth_angle_rad, RenderMesh* mesh) {
  const std::size_t count = mesh->triangles.size();
  mesh->face_normals.resize(count);
  mesh->normals.resize(count);
  mesh->flat.resize(count);
  std::vector<float> area(count);
  std::vector<int> first(mesh->vertices.size() + 1, 0);
  for (std::size_t t = 0; t < count; ++t) {
    const Vector3i& v = mesh->triangles[t];
    const Vector3f n = (mesh->vertices[v[1]] - mesh->vertices[v[0]])
                           .cross(mesh->vertices[v[2]] - mesh->vertices[v[0]]);
    area[t] = n.norm();
    mesh->face_normals[t] = n.normalized();
    for (const int k : v) ++first[k + 1];
  }
  std::partial_sum(first.begin(), first.end(), first.begin());
  struct Corner {
    int triangle;
    float weight;
  };
  std::vector<Corner> corners(3 * count);
  std::vector<int> next(first.begin(), first.end() - 1);
  for (int t = 0; t < static_cast<int>(count); ++t) {
    for (int k = 0; k < 3; ++k) {
      const auto angle = static_cast<float>(CornerAngle(*mesh, t, k));
      corners[next[mesh->triangles[t][k]]++] = {t, area[t] * angle};
    }
  }
  const auto least = static_cast<float>(std::cos(smooth_angle_rad));
  for (std::size_t t = 0; t < count; ++t) {
    const Vector3f& own = mesh->face_normals[t];
    for (int k = 0; k < 3; ++k) {
      const int v = mesh->triangles[t][k];
      Vector3f sum = Vector3f::Zero();
      for (int i = first[v]; i < first[v + 1]; ++i) {
        const Vector3f& n = mesh->face_normals[corners[i].triangle];
        const float cosine = n.dot(own);
        if (cosine >= least) sum += corners[i].weight * n;
        // A neighbour that is inside out.
        if (!mesh->closed && cosine <= -least) sum -= corners[i].weight * n;
      }
      mesh->normals[t][k] = sum.normalized();
    }
    const auto& n = mesh->normals[t];
    mesh->flat[t] = std::min({n[0].dot(own), n[1].dot(own), n[2].dot(own)}) > kFlatCosine;
  }
}

void FillSharpEdges(RenderMesh* mesh) {
  const auto least = static_cast<float>(std::cos(kSharpTurnRad));
  mesh->sharp_edges.clear();
  for (const RenderMeshEdge& e : mesh->edges) {
    if (e.right < 0) continue;
    float cosine = mesh->face_normals[e.left].dot(mesh->face_normals[e.right]);
    if (e.same_winding) cosine = -cosine;
    if (cosine < least) mesh->sharp_edges.push_back({e, std::acos(std::max(-1.0f, cosine))});
  }
}

}  // namespace

void ConnectRenderMesh(double smooth_angle_rad, RenderMesh* mesh) {
  Vector3f low = mesh->vertices.front(), high = low;
  for (const Vector3f& p : mesh->vertices) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  mesh->center = 0.5f * (low + high);
  mesh->closed = FillEdges(mesh) && MakeOutward(mesh);
  FillNormals(smooth_angle_rad, mesh);
  FillSharpEdges(mesh);
}

absl::StatusOr<RenderMesh> MakeRenderMesh(const TriangleMesh& mesh,
                                          double diameter_m,
                                          const RenderMeshOptions& options) {
  const absl::StatusOr<Box> box = MeshBox(mesh);
  if (!box.ok()) return box.status();
  const double diameter = diameter_m > 0.0 ? diameter_m : box->size().norm();
  // A float, so that the mesh can say it exactly; a little more, so that rounding stays on the
  // grid.
  const auto step = static_cast<float>(box->size().maxCoeff() / kGridSteps * (1.0 + 1e-6));
  IndexedMesh work{mesh.vertices, mesh.triangles};
  if (work.triangles.size() > kManyTriangles) {
    work = ClusterVertices(work, kClusterCell * diameter);
  }
  work = Weld(work, *box, step);
  work = Decimate(
      std::move(work),
      {options.tolerance * diameter, options.max_triangles, options.coarse_tolerance * diameter});
  // On the grid, and once more without what collapsed there.
  for (Vector3d& p : work.vertices) {
    p = p.cwiseMax(box->low).cwiseMin(box->high);
    p = FromKey(GridKey(p, *box, step), *box, step);
  }
  work = Weld(work, *box, step);
  if (!HasArea(work)) {
    return absl::InvalidArgumentError("mesh: no triangle of positive area");
  }
  RenderMesh out;
  out.origin = box->low.cast<float>();
  out.step_m = step;
  out.diameter_m = diameter;
  for (const Vector3d& p : work.vertices) {
    const Vector3f steps = ((p - box->low) / step).array().round().cast<float>();
    out.vertices.push_back(GridPoint(out, steps));
  }
  out.triangles = std::move(work.triangles);
  ConnectRenderMesh(options.smooth_angle_rad, &out);
  return out;
}

}  // namespace horopter
