// Solid cells of a part and the volume two placed parts share.
#include <algorithm>
#include <cmath>

#include "server/base/stop_scope.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr int kLongestSide = 40;        // cells along the longest side of the bounding box
constexpr std::size_t kInterior = 300;  // cells kept of those inside a part; for time

// z of the triangle above (x, y), if it covers that point.
bool HeightAt(const Eigen::Vector3d& a,
              const Eigen::Vector3d& b,
              const Eigen::Vector3d& c,
              double x,
              double y,
              double* z) {
  const double area = (b.x() - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (b.y() - a.y());
  if (area == 0.0) return false;
  const double u = ((x - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (y - a.y())) / area;
  const double v = ((b.x() - a.x()) * (y - a.y()) - (x - a.x()) * (b.y() - a.y())) / area;
  if (u < 0 || v < 0 || u + v > 1) return false;
  *z = a.z() + u * (b.z() - a.z()) + v * (c.z() - a.z());
  return true;
}

}  // namespace

bool Occupancy::Contains(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d cell = (point - origin) / cell_m;
  for (int k = 0; k < 3; ++k) {
    if (!(cell[k] >= 0 && cell[k] < size[k])) return false;
  }
  const Eigen::Vector3i i = cell.cast<int>();
  return inside[(static_cast<std::size_t>(i.z()) * size.y() + i.y()) * size.x() + i.x()];
}

Occupancy ComputeOccupancy(const TriangleMesh& mesh) {
  Occupancy out;
  if (mesh.vertices.empty()) return out;
  Eigen::Vector3d low = mesh.vertices[0], high = low;
  for (const auto& v : mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  const double longest = (high - low).maxCoeff();
  if (!(longest > 0)) return out;
  out.cell_m = longest / kLongestSide;
  out.origin = low;
  for (int k = 0; k < 3; ++k)
    out.size[k] = std::max(1, static_cast<int>(std::ceil((high - low)[k] / out.cell_m)));
  out.inside.assign(static_cast<std::size_t>(out.size.prod()), false);
  // An irrational shift keeps the rays off vertices and edges, which lie at round numbers.
  const double shift = 0.4142135 * out.cell_m;
  for (int y = 0; y < out.size.y(); ++y) {
    LeaveIfStopped();
    for (int x = 0; x < out.size.x(); ++x) {
      const double px = low.x() + x * out.cell_m + shift, py = low.y() + y * out.cell_m + shift;
      std::vector<double> crossings;
      for (const auto& t : mesh.triangles) {
        double z;
        if (HeightAt(mesh.vertices[t[0]], mesh.vertices[t[1]], mesh.vertices[t[2]], px, py, &z))
          crossings.push_back(z);
      }
      std::sort(crossings.begin(), crossings.end());
      for (int z = 0; z < out.size.z(); ++z) {
        const double pz = low.z() + (z + 0.5) * out.cell_m;
        const auto below =
            std::lower_bound(crossings.begin(), crossings.end(), pz) - crossings.begin();
        if (below % 2 == 0) continue;
        out.inside[(static_cast<std::size_t>(z) * out.size.y() + y) * out.size.x() + x] = true;
        out.interior.push_back(Eigen::Vector3d(px, py, pz).cast<float>());
      }
    }
  }
  if (out.interior.size() > kInterior) {
    std::vector<Eigen::Vector3f> fewer;
    for (std::size_t i = 0; i < kInterior; ++i)
      fewer.push_back(out.interior[i * out.interior.size() / kInterior]);
    out.interior = std::move(fewer);
  }
  return out;
}

double SharedVolume(const PreparedObject& a,
                    const Rigid3& scene_from_a,
                    const PreparedObject& b,
                    const Rigid3& scene_from_b) {
  if ((scene_from_a * a.center - scene_from_b * b.center).norm() > a.radius_m + b.radius_m)
    return 0.0;
  auto share = [](const PreparedObject& of,
                  const Rigid3& scene_from_of,
                  const PreparedObject& in,
                  const Rigid3& scene_from_in) {
    if (of.occupancy.interior.empty() || in.occupancy.inside.empty()) return 0.0;
    const Rigid3 in_from_of = scene_from_in.Inverse() * scene_from_of;
    int hits = 0;
    for (const auto& p : of.occupancy.interior)
      hits += in.occupancy.Contains(in_from_of * p.cast<double>());
    return static_cast<double>(hits) / static_cast<double>(of.occupancy.interior.size());
  };
  return std::max(share(a, scene_from_a, b, scene_from_b), share(b, scene_from_b, a, scene_from_a));
}

}  // namespace horopter
