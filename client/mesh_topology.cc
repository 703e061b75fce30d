#include "client/mesh_topology.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <map>
#include <numeric>
#include <queue>
#include <set>
#include <unordered_map>

namespace horopter {
namespace {

using Cell = std::array<int64_t, 3>;
struct CellHash {
  size_t operator()(const Cell& c) const {
    uint64_t h = 1469598103934665603ull;
    for (const int64_t v : c) h = (h ^ static_cast<uint64_t>(v)) * 1099511628211ull;
    return h;
  }
};

// Index of the representative of every vertex; the representative is the first of its cluster.
std::vector<int> Weld(const std::vector<Eigen::Vector3d>& points, double distance) {
  std::unordered_map<Cell, std::vector<int>, CellHash> grid;
  std::vector<int> representative(points.size());
  const double cell = std::max(distance * 2.0, 1e-12);
  const auto key = [&](const Eigen::Vector3d& p) {
    return Cell{static_cast<int64_t>(std::floor(p.x() / cell)),
                static_cast<int64_t>(std::floor(p.y() / cell)),
                static_cast<int64_t>(std::floor(p.z() / cell))};
  };
  for (int i = 0; i < static_cast<int>(points.size()); ++i) {
    const Cell k = key(points[i]);
    int found = -1;
    for (int n = 0; n < 27 && found < 0; ++n) {
      const auto it = grid.find({k[0] + n % 3 - 1, k[1] + n / 3 % 3 - 1, k[2] + n / 9 - 1});
      if (it == grid.end()) continue;
      for (const int j : it->second) {
        if ((points[j] - points[i]).norm() <= distance) {
          found = j;
          break;
        }
      }
    }
    representative[i] = found < 0 ? i : found;
    if (found < 0) grid[k].push_back(i);
  }
  return representative;
}

std::pair<int, int> Ordered(int a, int b) {
  return {std::min(a, b), std::max(a, b)};
}

std::map<std::pair<int, int>, std::vector<int>> Adjacency(const TriangleMesh& mesh) {
  std::map<std::pair<int, int>, std::vector<int>> adjacency;
  for (int t = 0; t < static_cast<int>(mesh.triangles.size()); ++t) {
    for (int k = 0; k < 3; ++k) {
      adjacency[Ordered(mesh.triangles[t][k], mesh.triangles[t][(k + 1) % 3])].push_back(t);
    }
  }
  return adjacency;
}

bool Degenerate(const TriangleMesh& mesh, const Eigen::Vector3i& t, double distance) {
  if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) return true;
  const Eigen::Vector3d u = mesh.vertices[t[1]] - mesh.vertices[t[0]];
  const Eigen::Vector3d v = mesh.vertices[t[2]] - mesh.vertices[t[0]];
  const double longest = std::max({u.norm(), v.norm(), (u - v).norm()});
  return u.cross(v).norm() <= distance * longest;  // height over the longest side
}

// Splits triangles whose open edge carries a vertex of another open edge. Returns the number of
// splits of one round.
int SplitAtJunctions(TriangleMesh& mesh, double distance) {
  std::vector<std::pair<std::pair<int, int>, int>> open;
  std::vector<int> border;
  for (const auto& [edge, triangles] : Adjacency(mesh)) {
    if (triangles.size() != 1) continue;
    open.push_back({edge, triangles[0]});
    border.push_back(edge.first);
    border.push_back(edge.second);
  }
  constexpr size_t kMaxOpenEdges = 4000;  // quadratic below; such a mesh is an open shell anyway
  if (open.size() > kMaxOpenEdges) return 0;
  std::sort(border.begin(), border.end());
  border.erase(std::unique(border.begin(), border.end()), border.end());
  std::vector<bool> touched(mesh.triangles.size(), false);
  int splits = 0;
  for (const auto& [edge, t] : open) {
    if (touched[t]) continue;  // its edges changed in this round; the next round sees them
    const Eigen::Vector3d a = mesh.vertices[edge.first];
    const Eigen::Vector3d d = mesh.vertices[edge.second] - a;
    for (const int v : border) {
      if (v == edge.first || v == edge.second) continue;
      const Eigen::Vector3d r = mesh.vertices[v] - a;
      const double s = r.dot(d) / d.squaredNorm();
      if (s <= 0.0 || s >= 1.0 || (r - s * d).norm() > distance) continue;
      Eigen::Vector3i first = mesh.triangles[t], second = first;
      if ((first.array() == v).any()) continue;
      for (int k = 0; k < 3; ++k) {
        if (first[k] == edge.first) first[k] = v;
        if (second[k] == edge.second) second[k] = v;
      }
      mesh.triangles[t] = first;
      mesh.triangles.push_back(second);
      if (!mesh.colors.empty()) mesh.colors.push_back(Rgba(mesh.colors[t]));
      touched[t] = true;
      touched.push_back(true);
      ++splits;
      break;
    }
  }
  return splits;
}

// Whether the triangle runs from a to b.
bool Runs(const Eigen::Vector3i& t, int a, int b) {
  for (int k = 0; k < 3; ++k) {
    if (t[k] == a && t[(k + 1) % 3] == b) return true;
  }
  return false;
}

// Triangles that hang together.
struct Shell {
  std::vector<int> members;
  std::vector<int> turned;  // of them, against how they came
  bool closed = true;
  double volume = 0.0;
  Eigen::AlignedBox3d box;
};

// Makes neighbours agree; most of a shell stays as it came.
Shell Agree(const std::map<std::pair<int, int>, std::vector<int>>& adjacency,
            int seed,
            TriangleMesh* mesh,
            std::vector<char>* seen) {
  Shell shell;
  std::queue<int> queue({seed});
  (*seen)[seed] = 1;
  while (!queue.empty()) {
    const int t = queue.front();
    queue.pop();
    shell.members.push_back(t);
    for (int k = 0; k < 3; ++k) {
      const int a = mesh->triangles[t][k], b = mesh->triangles[t][(k + 1) % 3];
      const auto& neighbours = adjacency.at(Ordered(a, b));
      shell.closed = shell.closed && neighbours.size() == 2;
      if (neighbours.size() != 2) continue;
      const int u = neighbours[0] == t ? neighbours[1] : neighbours[0];
      if ((*seen)[u]) continue;
      (*seen)[u] = 1;
      if (Runs(mesh->triangles[u], a, b)) {
        std::swap(mesh->triangles[u][1], mesh->triangles[u][2]);
        shell.turned.push_back(u);
      }
      queue.push(u);
    }
  }
  return shell;
}

void TurnShell(TriangleMesh* mesh, Shell* shell) {
  for (const int t : shell->members) std::swap(mesh->triangles[t][1], mesh->triangles[t][2]);
  std::vector<int> members = shell->members, turned = shell->turned, others;
  std::sort(members.begin(), members.end());
  std::sort(turned.begin(), turned.end());
  std::set_difference(
      members.begin(), members.end(), turned.begin(), turned.end(), std::back_inserter(others));
  shell->turned = std::move(others);
  shell->volume = -shell->volume;
}

// Makes neighbours agree, then turns closed shells outward that are inside no other one. Returns
// whether the mesh is closed, and how many triangles were turned.
bool Orient(TriangleMesh& mesh, int* turned) {
  const auto adjacency = Adjacency(mesh);
  std::vector<char> seen(mesh.triangles.size(), 0);
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  for (const auto& v : mesh.vertices) origin += v / static_cast<double>(mesh.vertices.size());
  std::vector<Shell> shells;
  for (int seed = 0; seed < static_cast<int>(mesh.triangles.size()); ++seed) {
    if (seen[seed]) continue;
    Shell shell = Agree(adjacency, seed, &mesh, &seen);
    for (const int t : shell.members) {
      const Eigen::Vector3i& v = mesh.triangles[t];
      shell.volume += (mesh.vertices[v[0]] - origin)
                          .dot((mesh.vertices[v[1]] - origin).cross(mesh.vertices[v[2]] - origin));
      for (const int k : v) shell.box.extend(mesh.vertices[k]);
    }
    if (2 * shell.turned.size() > shell.members.size()) TurnShell(&mesh, &shell);
    shells.push_back(std::move(shell));
  }
  bool all_closed = true;
  *turned = 0;
  for (Shell& shell : shells) {
    all_closed = all_closed && shell.closed;
    const bool inside = std::any_of(shells.begin(), shells.end(), [&](const Shell& other) {
      return &other != &shell && other.closed && other.box.contains(shell.box) &&
             std::abs(other.volume) > std::abs(shell.volume);
    });
    if (shell.closed && !inside && shell.volume < 0.0) TurnShell(&mesh, &shell);
    *turned += static_cast<int>(shell.turned.size());
  }
  return all_closed;
}

}  // namespace

CleanMesh CleanTriangleSoup(const TriangleMesh& soup, double weld_distance) {
  CleanMesh clean;
  const std::vector<int> representative = Weld(soup.vertices, weld_distance);
  std::vector<int> renumbered(soup.vertices.size(), -1);
  TriangleMesh& mesh = clean.mesh;
  std::set<std::array<int, 3>> known;
  for (size_t i = 0; i < soup.triangles.size(); ++i) {
    const Eigen::Vector3i& t = soup.triangles[i];
    const Eigen::Vector3i welded(representative[t[0]], representative[t[1]], representative[t[2]]);
    if (Degenerate(soup, welded, weld_distance)) {
      ++clean.degenerate_triangles;
      continue;
    }
    Eigen::Vector3i out;
    for (int k = 0; k < 3; ++k) {
      int& index = renumbered[welded[k]];
      if (index < 0) {
        index = static_cast<int>(mesh.vertices.size());
        mesh.vertices.push_back(soup.vertices[welded[k]]);
      }
      out[k] = index;
    }
    std::array<int, 3> same = {out[0], out[1], out[2]};
    std::sort(same.begin(), same.end());
    if (!known.insert(same).second) {
      ++clean.duplicate_triangles;
      continue;
    }
    mesh.triangles.push_back(out);
    if (!soup.colors.empty()) mesh.colors.push_back(soup.colors[i]);
  }
  if (std::all_of(mesh.colors.begin(), mesh.colors.end(), [](const Rgba& color) {
        return color == kNoColor;
      })) {
    mesh.colors.clear();
  }
  constexpr int kMaxRounds =
      20;  // one long edge beside a finely divided one needs one round per division
  for (int round = 0; round < kMaxRounds; ++round) {
    const int splits = SplitAtJunctions(mesh, weld_distance);
    if (splits == 0) break;
    clean.split_triangles += splits;
  }
  clean.closed = !mesh.triangles.empty() && Orient(mesh, &clean.turned_triangles);
  return clean;
}

std::vector<int> TriangleRegions(std::size_t triangles,
                                 const std::vector<MeshEdge>& edges,
                                 const std::function<bool(const MeshEdge&)>& joins) {
  std::vector<int> parent(triangles);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int t) {
    while (parent[t] != t) t = parent[t] = parent[parent[t]];
    return t;
  };
  for (const MeshEdge& e : edges) {
    if (e.triangle_2 >= 0 && joins(e)) parent[root(e.triangle_1)] = root(e.triangle_2);
  }
  for (std::size_t t = 0; t < triangles; ++t) parent[t] = root(static_cast<int>(t));
  return parent;
}

std::vector<Eigen::Vector3d> TriangleNormals(const TriangleMesh& mesh) {
  std::vector<Eigen::Vector3d> normals;
  normals.reserve(mesh.triangles.size());
  for (const Eigen::Vector3i& t : mesh.triangles) {
    normals.push_back((mesh.vertices[t[1]] - mesh.vertices[t[0]])
                          .cross(mesh.vertices[t[2]] - mesh.vertices[t[0]])
                          .normalized());
  }
  return normals;
}

std::vector<MeshEdge> MeshEdges(const TriangleMesh& mesh) {
  const std::vector<Eigen::Vector3d> normals = TriangleNormals(mesh);
  std::vector<MeshEdge> edges;
  for (const auto& [key, triangles] : Adjacency(mesh)) {
    MeshEdge edge{key.first, key.second, triangles[0], -1, M_PI};
    edge.triangles = static_cast<int>(triangles.size());
    if (triangles.size() >= 2) {
      edge.triangle_2 = triangles[1];
      const Eigen::Vector3d &n1 = normals[triangles[0]], &n2 = normals[triangles[1]];
      edge.dihedral_rad = std::atan2(n1.cross(n2).norm(), n1.dot(n2));
    }
    edges.push_back(edge);
  }
  return edges;
}

}  // namespace horopter
