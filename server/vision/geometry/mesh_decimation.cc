#include "server/vision/geometry/mesh_decimation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cstdint>
#include <queue>
#include <tuple>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/container/inlined_vector.h"
#include "server/base/stop_scope.h"

namespace horopter {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr int kStepsPerLook = 256;  // at the stop flag

// A vertex sums up the planes of all it has swallowed, so its error is overrated many times on
// round surfaces. Passes forget them; each may use a part of the tolerance.
constexpr int kPasses = 4;
constexpr double kPassShare = 0.5;
constexpr double kWorthwhile = 0.95;  // of the triangles left: another pass is of no use
// Pulls a cluster to the mean of its points where its planes leave it free.
constexpr double kMeanPull = 0.02;

// The sum of squared distances of a point to planes n x + d = 0: x'A x + 2 b'x + c.
struct Quadric {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  Vector3d b = Vector3d::Zero();
  double c = 0;

  void AddPlane(const Vector3d& n, double d) {
    xx += n.x() * n.x();
    xy += n.x() * n.y();
    xz += n.x() * n.z();
    yy += n.y() * n.y();
    yz += n.y() * n.z();
    zz += n.z() * n.z();
    b += d * n;
    c += d * d;
  }
  Quadric& operator+=(const Quadric& q) {
    xx += q.xx;
    xy += q.xy;
    xz += q.xz;
    yy += q.yy;
    yz += q.yz;
    zz += q.zz;
    b += q.b;
    c += q.c;
    return *this;
  }
  Eigen::Matrix3d A() const {
    return (Eigen::Matrix3d() << xx, xy, xz, xy, yy, yz, xz, yz, zz).finished();
  }
  double At(const Vector3d& p) const { return std::max(0.0, p.dot(A() * p) + 2.0 * b.dot(p) + c); }
};

struct Collapse {
  double cost;
  int a, b;
  std::uint32_t stamp;  // sum of both vertices' versions: stale if it differs
  Vector3d place;

  // For a queue that gives the cheapest first, ties by index: deterministic.
  bool operator<(const Collapse& other) const {
    return std::tie(cost, a, b) > std::tie(other.cost, other.a, other.b);
  }
};

using Ring = absl::InlinedVector<int, 8>;

class Decimator {
 public:
  explicit Decimator(IndexedMesh mesh) : mesh_(std::move(mesh)) {
    const std::size_t n = mesh_.vertices.size();
    quadrics_.resize(n);
    rings_.resize(n);
    versions_.assign(n, 0);
    alive_.assign(mesh_.triangles.size(), 1);
    left_ = static_cast<int>(mesh_.triangles.size());
    for (int t = 0; t < left_; ++t) {
      for (const int v : mesh_.triangles[t]) rings_[v].push_back(t);
    }
    StopPacer pacer(kStepsPerLook);
    for (int t = 0; t < left_; ++t) {
      pacer.Step();
      AddTriangle(t);
    }
    for (int v = 0; v < static_cast<int>(n); ++v) {
      pacer.Step();
      for (const int u : Neighbors(v)) {
        if (u > v) Push(v, u);
      }
    }
  }

  void Run(const DecimationLimits& limits) {
    const double fine = limits.tolerance * limits.tolerance;
    const double coarse = limits.coarse_tolerance * limits.coarse_tolerance;
    StopPacer pacer(kStepsPerLook);
    while (!queue_.empty()) {
      pacer.Step();
      const Collapse next = queue_.top();
      if (next.cost > (left_ > limits.max_triangles ? std::max(fine, coarse) : fine)) break;
      queue_.pop();
      if (next.stamp != versions_[next.a] + versions_[next.b] || rings_[next.a].empty() ||
          rings_[next.b].empty()) {
        continue;
      }
      if (Allowed(next)) Apply(next);
    }
  }

  IndexedMesh Take() {
    IndexedMesh out;
    std::vector<int> index(mesh_.vertices.size(), -1);
    for (std::size_t t = 0; t < mesh_.triangles.size(); ++t) {
      if (!alive_[t]) continue;
      Vector3i triangle = mesh_.triangles[t];
      for (int& v : triangle) {
        if (index[v] < 0) {
          index[v] = static_cast<int>(out.vertices.size());
          out.vertices.push_back(mesh_.vertices[v]);
        }
        v = index[v];
      }
      out.triangles.push_back(triangle);
    }
    return out;
  }

 private:
  Vector3d Normal(int t) const {
    const Vector3i& v = mesh_.triangles[t];
    const Vector3d& a = mesh_.vertices[v[0]];
    return (mesh_.vertices[v[1]] - a).cross(mesh_.vertices[v[2]] - a);
  }

  // The triangle's plane for its corners, and a wall through each border for the border's ends.
  void AddTriangle(int t) {
    const Vector3d n = Normal(t).normalized();
    const Vector3i& v = mesh_.triangles[t];
    for (int k = 0; k < 3; ++k) {
      quadrics_[v[k]].AddPlane(n, -n.dot(mesh_.vertices[v[k]]));
      const int a = v[k], b = v[(k + 1) % 3];
      if (Shared(a, b) == 2) continue;
      const Vector3d wall = n.cross(mesh_.vertices[b] - mesh_.vertices[a]).normalized();
      const double d = -wall.dot(mesh_.vertices[a]);
      quadrics_[a].AddPlane(wall, d);
      quadrics_[b].AddPlane(wall, d);
    }
  }

  bool Has(int t, int v) const {
    const Vector3i& triangle = mesh_.triangles[t];
    return triangle[0] == v || triangle[1] == v || triangle[2] == v;
  }

  int Shared(int a, int b) const {
    int count = 0;
    for (const int t : rings_[a]) count += Has(t, b);
    return count;
  }

  Ring Neighbors(int v) const {
    Ring out;
    for (const int t : rings_[v]) {
      for (const int u : mesh_.triangles[t]) {
        if (u != v && std::find(out.begin(), out.end(), u) == out.end()) out.push_back(u);
      }
    }
    return out;
  }

  void Push(int a, int b) {
    Quadric q = quadrics_[a];
    q += quadrics_[b];
    const Vector3d& pa = mesh_.vertices[a];
    const Vector3d& pb = mesh_.vertices[b];
    Collapse best{1e300, std::min(a, b), std::max(a, b), versions_[a] + versions_[b], pa};
    const auto consider = [&](const Vector3d& p) {
      const double cost = q.At(p);
      if (cost < best.cost) {
        best.cost = cost;
        best.place = p;
      }
    };
    consider(pa);
    consider(pb);
    consider(0.5 * (pa + pb));
    // The best place, where the planes fix one: near the edge, or it is badly conditioned.
    const Eigen::Matrix3d m = q.A();
    const double det = m.determinant();
    const double scale = m.trace() / 3.0;
    if (det > 1e-3 * scale * scale * scale) {
      const Vector3d p = -(m.inverse() * q.b);
      if ((p - 0.5 * (pa + pb)).norm() < 1.5 * (pa - pb).norm()) consider(p);
    }
    // Flat regions cost nothing anywhere: short edges first keeps triangles compact.
    best.cost += 1e-9 * (pa - pb).squaredNorm();
    queue_.push(best);
  }

  // Neither topology nor orientation of what is around the edge changes.
  bool Allowed(const Collapse& c) const {
    const Ring na = Neighbors(c.a), nb = Neighbors(c.b);
    int common = 0;
    for (const int u : na) common += std::find(nb.begin(), nb.end(), u) != nb.end();
    const int shared = Shared(c.a, c.b);
    if (shared > 2 || common != shared) return false;
    return KeepsSides(c.a, c.b, c.place) && KeepsSides(c.b, c.a, c.place);
  }

  bool KeepsSides(int moved, int other, const Vector3d& place) const {
    for (const int t : rings_[moved]) {
      if (Has(t, other)) continue;
      std::array<Vector3d, 3> p;
      for (int k = 0; k < 3; ++k) {
        const int v = mesh_.triangles[t][k];
        p[k] = v == moved ? place : mesh_.vertices[v];
      }
      const Vector3d before = Normal(t);
      const Vector3d after = (p[1] - p[0]).cross(p[2] - p[0]);
      const double longest = std::max(
          {(p[1] - p[0]).squaredNorm(), (p[2] - p[1]).squaredNorm(), (p[0] - p[2]).squaredNorm()});
      if (after.norm() < 1e-3 * longest && after.norm() < 0.5 * before.norm()) return false;
      if (before.dot(after) < 0.7 * before.norm() * after.norm()) return false;
    }
    return true;
  }

  void Apply(const Collapse& c) {
    mesh_.vertices[c.a] = c.place;
    quadrics_[c.a] += quadrics_[c.b];
    Ring ring;
    for (const int t : rings_[c.a]) {
      if (!Has(t, c.b)) ring.push_back(t);
    }
    for (const int t : rings_[c.b]) {
      if (Has(t, c.a)) {
        alive_[t] = 0;
        --left_;
        for (const int v : mesh_.triangles[t]) {
          if (v != c.a && v != c.b) Remove(t, &rings_[v]);
        }
      } else {
        for (int& v : mesh_.triangles[t]) {
          if (v == c.b) v = c.a;
        }
        ring.push_back(t);
      }
    }
    rings_[c.a] = std::move(ring);
    rings_[c.b].clear();
    ++versions_[c.a];
    for (const int u : Neighbors(c.a)) Push(c.a, u);
  }

  static void Remove(int t, Ring* ring) {
    ring->erase(std::remove(ring->begin(), ring->end(), t), ring->end());
  }

  IndexedMesh mesh_;
  std::vector<Quadric> quadrics_;
  std::vector<Ring> rings_;  // live triangles around each vertex
  std::vector<std::uint32_t> versions_;
  std::vector<char> alive_;
  int left_ = 0;
  std::priority_queue<Collapse> queue_;
};

}  // namespace

IndexedMesh ClusterVertices(const IndexedMesh& mesh, double cell) {
  struct Cluster {
    Vector3d sum = Vector3d::Zero();
    int count = 0;
    Quadric planes;  // about the first point, in cells
    Vector3d first = Vector3d::Zero();
  };
  absl::flat_hash_map<std::uint64_t, int> cells;
  std::vector<Cluster> clusters;
  std::vector<int> index(mesh.vertices.size());
  Vector3d low = mesh.vertices.front();
  for (const Vector3d& p : mesh.vertices) low = low.cwiseMin(p);
  StopPacer pacer(kStepsPerLook);
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    pacer.Step();
    const Vector3d& p = mesh.vertices[i];
    std::uint64_t key = 0;
    for (int k = 0; k < 3; ++k) {
      key = key << 21 | static_cast<std::uint64_t>(std::min((p[k] - low[k]) / cell, 2e6));
    }
    const auto [it, added] = cells.try_emplace(key, static_cast<int>(clusters.size()));
    if (added) clusters.emplace_back().first = p;
    index[i] = it->second;
    Cluster& c = clusters[it->second];
    c.sum += (p - c.first) / cell;
    ++c.count;
  }
  IndexedMesh out;
  for (const Vector3i& t : mesh.triangles) {
    pacer.Step();
    const Vector3d& a = mesh.vertices[t[0]];
    const Vector3d n = (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).normalized();
    const Vector3i mapped(index[t[0]], index[t[1]], index[t[2]]);
    for (const int k : mapped) {
      Cluster& c = clusters[k];
      c.planes.AddPlane(n, -n.dot(a - c.first) / cell);
    }
    if (mapped[0] != mapped[1] && mapped[1] != mapped[2] && mapped[2] != mapped[0]) {
      out.triangles.push_back(mapped);
    }
  }
  for (const Cluster& c : clusters) {
    pacer.Step();
    // Where its planes meet: corners and edges stay sharp.
    const Vector3d mean = c.sum / c.count;
    const Eigen::Matrix3d m = c.planes.A();
    const double pull = kMeanPull * m.trace() + 1e-12;
    const Vector3d best =
        (m + pull * Eigen::Matrix3d::Identity()).inverse() * (pull * mean - c.planes.b);
    out.vertices.push_back(c.first + cell * ((best - mean).norm() < 1.0 ? best : mean));
  }
  return out;
}

IndexedMesh Decimate(IndexedMesh mesh, const DecimationLimits& limits) {
  DecimationLimits pass = limits;
  pass.tolerance *= kPassShare;
  pass.coarse_tolerance *= kPassShare;
  for (int i = 0; i < kPasses; ++i) {
    const std::size_t before = mesh.triangles.size();
    Decimator decimator(std::move(mesh));
    decimator.Run(pass);
    mesh = decimator.Take();
    if (mesh.triangles.size() > kWorthwhile * static_cast<double>(before)) break;
  }
  return mesh;
}

}  // namespace horopter
