#include "server/vision/geometry/mesh_denoising.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

namespace horopter {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr double kScanShare = 0.5, kScanRoughness = 0.007;
constexpr double kSmoothCosine = 0.643;  // 50 degrees
constexpr int kMostMeasured = 10000;     // vertices
constexpr int kHub = 64;                 // triangles
constexpr int kLeastNeighbours = 9;      // of a paraboloid of six parameters

constexpr double kNormalSigma = 0.35;  // of the difference of two unit normals
constexpr int kNormalRounds = 20;
constexpr int kVertexRounds = 20;
constexpr double kLargestMove = 4.0;  // deviations

// Triangles of every vertex.
struct Fans {
  std::vector<int> first;  // by vertex, one more at the end
  std::vector<int> triangles;

  explicit Fans(const TriangleMesh& mesh) : first(mesh.vertices.size() + 1, 0) {
    for (const Vector3i& t : mesh.triangles) {
      for (const int v : t) ++first[v + 1];
    }
    for (std::size_t v = 1; v < first.size(); ++v) first[v] += first[v - 1];
    triangles.resize(first.back());
    std::vector<int> next(first.begin(), first.end() - 1);
    for (int t = 0; t < static_cast<int>(mesh.triangles.size()); ++t) {
      for (const int v : mesh.triangles[t]) triangles[next[v]++] = t;
    }
  }

  // Of these vertices' triangles, each once. Hubs are left out: scans have none, and their cost is
  // the square of their triangles.
  std::vector<int> Around(const std::vector<int>& vertices) const {
    std::vector<int> out;
    for (const int v : vertices) {
      if (first[v + 1] - first[v] > kHub) continue;
      out.insert(out.end(), triangles.begin() + first[v], triangles.begin() + first[v + 1]);
    }
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
    return out;
  }
};

std::vector<int> VerticesOf(const TriangleMesh& mesh, const std::vector<int>& triangles) {
  std::vector<int> out;
  for (const int t : triangles) {
    for (const int v : mesh.triangles[t]) out.push_back(v);
  }
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

struct Faces {
  std::vector<Vector3d> normals;  // unit
  std::vector<Vector3d> centroids;
  std::vector<double> areas;

  explicit Faces(const TriangleMesh& mesh) {
    for (const Vector3i& t : mesh.triangles) {
      const Vector3d &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
      const Vector3d n = (b - a).cross(c - a);
      areas.push_back(0.5 * n.norm());
      normals.push_back(n.normalized());
      centroids.push_back((a + b + c) / 3.0);
    }
  }
};

// Rms distance of a vertex's second neighbourhood from its paraboloid, in the mesh's unit, and the
// mean length of its edges; negative: it turns too much, or has too few neighbours.
struct Misfit {
  double rms = -1.0;
  double edge = 0.0;
};

Misfit ParaboloidMisfit(const TriangleMesh& mesh, const Fans& fans, const Faces& faces, int v) {
  const std::vector<int> ring = VerticesOf(mesh, fans.Around({v}));
  const std::vector<int> triangles = fans.Around(ring);
  const std::vector<int> around = VerticesOf(mesh, triangles);
  Misfit out;
  if (ring.size() < 4 || static_cast<int>(around.size()) < kLeastNeighbours + 1) return out;
  Vector3d normal = Vector3d::Zero();
  for (const int t : triangles) normal += faces.areas[t] * faces.normals[t];
  normal.normalize();
  for (const int t : triangles) {
    if (faces.normals[t].dot(normal) < kSmoothCosine) return out;
  }
  const Vector3d u = normal.unitOrthogonal(), w = normal.cross(u);
  for (const int k : ring) {
    out.edge += (mesh.vertices[k] - mesh.vertices[v]).norm() / static_cast<double>(ring.size() - 1);
  }
  const auto rows = static_cast<Eigen::Index>(around.size());
  Eigen::MatrixXd A(rows, 6);
  Eigen::VectorXd z(rows);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const Vector3d p = (mesh.vertices[around[i]] - mesh.vertices[v]) / out.edge;
    const double x = u.dot(p), y = w.dot(p);
    A.row(i) << 1.0, x, y, x * x, x * y, y * y;
    z[i] = normal.dot(p);
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(A);
  const double squares = (A * qr.solve(z) - z).squaredNorm();
  out.rms =
      out.edge * std::sqrt(squares / static_cast<double>(std::max<Eigen::Index>(1, rows - 6)));
  return out;
}

struct Weighted {
  double value;
  double weight;
};

double Quantile(std::vector<Weighted> values, double share) {
  std::sort(values.begin(), values.end(), [](const Weighted& a, const Weighted& b) {
    return a.value < b.value;
  });
  double total = 0.0, sum = 0.0;
  for (const Weighted& w : values) total += w.weight;
  for (const Weighted& w : values) {
    sum += w.weight;
    if (sum >= share * total) return w.value;
  }
  return 0.0;
}

// Mean normals of the triangles that share a vertex with one, of those like its own.
std::vector<Vector3d> FilteredNormals(const TriangleMesh& mesh, const Faces& faces) {
  const Fans fans(mesh);
  const int count = static_cast<int>(mesh.triangles.size());
  std::vector<std::vector<int>> around(count);
  double distance = 0.0;
  std::size_t pairs = 0;
  for (int t = 0; t < count; ++t) {
    const Vector3i& v = mesh.triangles[t];
    around[t] = fans.Around({v[0], v[1], v[2]});
    if (around[t].empty()) around[t] = {t};
    for (const int k : around[t]) distance += (faces.centroids[k] - faces.centroids[t]).norm();
    pairs += around[t].size() - 1;
  }
  distance /= static_cast<double>(std::max<std::size_t>(1, pairs));
  std::vector<Vector3d> normals = faces.normals, next = normals;
  for (int round = 0; round < kNormalRounds; ++round) {
    for (int t = 0; t < count; ++t) {
      Vector3d sum = Vector3d::Zero();
      for (const int k : around[t]) {
        const double near =
            (faces.centroids[k] - faces.centroids[t]).squaredNorm() / (2.0 * distance * distance);
        const double like =
            (normals[k] - normals[t]).squaredNorm() / (2.0 * kNormalSigma * kNormalSigma);
        sum += faces.areas[k] * std::exp(-near - like) * normals[k];
      }
      next[t] = sum.norm() > 0.0 ? sum.normalized() : normals[t];
    }
    std::swap(normals, next);
  }
  return normals;
}

}  // namespace

SurfaceNoise MeasureSurfaceNoise(const TriangleMesh& mesh) {
  const Fans fans(mesh);
  const Faces faces(mesh);
  const int count = static_cast<int>(mesh.vertices.size());
  const int step = std::max(1, count / kMostMeasured);
  double all = 0.0, smooth = 0.0;
  std::vector<Weighted> roughness, deviation;
  for (int v = 0; v < count; v += step) {
    double area = 0.0;
    for (int i = fans.first[v]; i < fans.first[v + 1]; ++i) area += faces.areas[fans.triangles[i]];
    all += area;
    const Misfit misfit = ParaboloidMisfit(mesh, fans, faces, v);
    if (misfit.rms < 0.0) continue;
    smooth += area;
    roughness.push_back({misfit.rms / misfit.edge, area});
    deviation.push_back({misfit.rms, area});
  }
  return {all > 0.0 ? smooth / all : 0.0,
          Quantile(std::move(roughness), 0.25),
          Quantile(std::move(deviation), 0.5)};
}

bool IsScan(const SurfaceNoise& noise) {
  return noise.smooth_share > kScanShare && noise.roughness > kScanRoughness;
}

DenoisedSurface Denoise(const TriangleMesh& mesh, const SurfaceNoise& noise) {
  DenoisedSurface out{FilteredNormals(mesh, Faces(mesh)), mesh};
  std::vector<Vector3d>& vertices = out.mesh.vertices;
  std::vector<int> triangles_of(vertices.size(), 0);
  for (const Vector3i& t : mesh.triangles) {
    for (const int v : t) ++triangles_of[v];
  }
  const double most = kLargestMove * noise.deviation;
  for (int round = 0; round < kVertexRounds; ++round) {
    std::vector<Vector3d> steps(vertices.size(), Vector3d::Zero());
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
      const Vector3i& c = mesh.triangles[t];
      const Vector3d centroid = (vertices[c[0]] + vertices[c[1]] + vertices[c[2]]) / 3.0;
      const Vector3d& n = out.normals[t];
      for (const int v : c) steps[v] += n.dot(centroid - vertices[v]) * n;
    }
    for (std::size_t v = 0; v < vertices.size(); ++v) {
      const Vector3d move =
          vertices[v] + steps[v] / std::max(1, triangles_of[v]) - mesh.vertices[v];
      const double length = move.norm();
      vertices[v] = mesh.vertices[v] + (length > most ? Vector3d(move * (most / length)) : move);
    }
  }
  return out;
}

}  // namespace horopter
