#include "server/vision/geometry/surface_distance.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

namespace horopter {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr int kCellsAlong = 48;  // the longest side of the box
constexpr int kMaxRings = 4;     // cells are looked at this far around a point at most

// Whether the plane of a triangle comes near a cell; the box of a slanted large triangle crosses
// many cells that the triangle does not.
bool PlaneCrosses(const Vector3d& a, const Vector3d& normal, const Vector3d& middle, double half) {
  return std::abs(normal.dot(middle - a)) <= half * normal.cwiseAbs().sum() * (1.0 + 1e-9);
}

}  // namespace

Vector3d NearestInTriangle(const Vector3d& p,
                           const Vector3d& a,
                           const Vector3d& b,
                           const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0.0 && d2 <= 0.0) return a;
  const Vector3d bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0.0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) return d1 == d3 ? a : Vector3d(a + d1 / (d1 - d3) * ab);
  const Vector3d cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0.0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) return d2 == d6 ? a : Vector3d(a + d2 / (d2 - d6) * ac);
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) {
    const double w = (d4 - d3) + (d5 - d6);
    return w > 0.0 ? Vector3d(b + (d4 - d3) / w * (c - b)) : b;
  }
  const double sum = va + vb + vc;
  return sum > 0.0 ? Vector3d(a + (vb * ab + vc * ac) / sum) : a;
}

SurfaceDistance::SurfaceDistance(const TriangleMesh& mesh, double reach)
    : mesh_(mesh), reach_(reach) {
  const int vertices = static_cast<int>(mesh.vertices.size());
  Eigen::AlignedBox3d box;
  std::vector<int> valid;
  for (int t = 0; t < static_cast<int>(mesh.triangles.size()); ++t) {
    const Vector3i& v = mesh.triangles[t];
    if (v.minCoeff() < 0 || v.maxCoeff() >= vertices) continue;
    valid.push_back(t);
    for (const int k : v) box.extend(mesh.vertices[k]);
  }
  if (valid.empty()) return;
  const double longest = std::max(box.sizes().maxCoeff(), 1e-12);
  cell_ = std::max(longest / kCellsAlong, reach / kMaxRings);
  low_ = box.min();
  for (int k = 0; k < 3; ++k) size_[k] = static_cast<int>(box.sizes()[k] / cell_) + 1;
  const auto cells = static_cast<std::size_t>(size_.x()) * size_.y() * size_.z();
  const auto for_each_cell = [&](const auto& visit) {
    for (const int t : valid) {
      const Vector3i& v = mesh.triangles[t];
      const Vector3d &a = mesh.vertices[v[0]], &b = mesh.vertices[v[1]], &c = mesh.vertices[v[2]];
      const Vector3i from = CellOf(a.cwiseMin(b).cwiseMin(c)),
                     to = CellOf(a.cwiseMax(b).cwiseMax(c));
      const Vector3d normal = (b - a).cross(c - a);
      for (int z = from.z(); z <= to.z(); ++z) {
        for (int y = from.y(); y <= to.y(); ++y) {
          for (int x = from.x(); x <= to.x(); ++x) {
            const Vector3d middle = low_ + cell_ * Vector3d(x + 0.5, y + 0.5, z + 0.5);
            if (!PlaneCrosses(a, normal, middle, 0.5 * cell_)) continue;
            visit((static_cast<std::size_t>(z) * size_.y() + y) * size_.x() + x, t);
          }
        }
      }
    }
  };
  first_.assign(cells + 1, 0);
  for_each_cell([&](std::size_t cell, int) { ++first_[cell + 1]; });
  std::partial_sum(first_.begin(), first_.end(), first_.begin());
  triangles_.resize(first_.back());
  std::vector<std::int32_t> next(first_.begin(), first_.end() - 1);
  for_each_cell([&](std::size_t cell, int t) { triangles_[next[cell]++] = t; });
}

Vector3i SurfaceDistance::CellOf(const Vector3d& p) const {
  Vector3i cell;
  for (int k = 0; k < 3; ++k) {
    const double at = std::floor((p[k] - low_[k]) / cell_);
    cell[k] = static_cast<int>(std::clamp(at, 0.0, size_[k] - 1.0));
  }
  return cell;
}

SurfaceDistance::Nearest SurfaceDistance::At(const Vector3d& p) const {
  Nearest out;
  out.distance = reach_;
  if (triangles_.empty()) return out;
  double best = reach_ * reach_;
  const Vector3d relative = (p - low_) / cell_;
  if (!relative.allFinite() || relative.minCoeff() < -kMaxRings - 1 ||
      (relative - size_.cast<double>()).maxCoeff() > kMaxRings + 1) {
    return out;
  }
  const Vector3i center = relative.array().floor().cast<int>();
  const auto look = [&](int x, int y, int z) {
    if (x < 0 || y < 0 || z < 0 || x >= size_.x() || y >= size_.y() || z >= size_.z()) return;
    const std::size_t cell = (static_cast<std::size_t>(z) * size_.y() + y) * size_.x() + x;
    for (std::int32_t i = first_[cell]; i < first_[cell + 1]; ++i) {
      const Vector3i& v = mesh_.triangles[triangles_[i]];
      const Vector3d q =
          NearestInTriangle(p, mesh_.vertices[v[0]], mesh_.vertices[v[1]], mesh_.vertices[v[2]]);
      const double squared = (q - p).squaredNorm();
      if (squared >= best) continue;
      best = squared;
      out.triangle = triangles_[i];
      out.point = q;
    }
  };
  const int rings = std::min(kMaxRings, static_cast<int>(std::ceil(reach_ / cell_)));
  for (int ring = 0; ring <= rings; ++ring) {
    // Cells of this ring are at least so far away.
    const double nearest = std::max(0, ring - 1) * cell_;
    if (ring > 1 && best <= nearest * nearest) break;
    for (int dz = -ring; dz <= ring; ++dz) {
      for (int dy = -ring; dy <= ring; ++dy) {
        const bool face = std::abs(dz) == ring || std::abs(dy) == ring;
        for (int dx = -ring; dx <= ring; dx += face || ring == 0 ? 1 : 2 * ring) {
          look(center.x() + dx, center.y() + dy, center.z() + dz);
        }
      }
    }
  }
  out.distance = std::sqrt(best);
  return out;
}

}  // namespace horopter
