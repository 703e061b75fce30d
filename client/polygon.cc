#include "client/polygon.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Turns left at every corner and goes round once.
bool IsConvex(const std::vector<Eigen::Vector3d>& points,
              const std::vector<int>& polygon,
              const Eigen::Vector3d& normal) {
  const size_t n = polygon.size();
  double turned = 0.0;
  for (size_t i = 0; i < n; ++i) {
    const Eigen::Vector3d u = points[polygon[(i + 1) % n]] - points[polygon[i]];
    const Eigen::Vector3d w = points[polygon[(i + 2) % n]] - points[polygon[(i + 1) % n]];
    const double area = normal.dot(u.cross(w));
    if (!(area > 0.0)) return false;  // straight corners too: a fan from one has flat triangles
    turned += std::atan2(area, normal.norm() * u.dot(w));
  }
  return turned < 3.0 * M_PI;  // 2 pi, not 4 pi
}

// Clips ears off a ring of corners.
class EarClipper {
 public:
  EarClipper(const std::vector<Eigen::Vector3d>& points,
             const std::vector<int>& polygon,
             const Eigen::Vector3d& normal)
      : points_(points), ring_(polygon), normal_(normal) {}

  std::vector<Eigen::Vector3i> Clip() {
    std::vector<Eigen::Vector3i> triangles;
    int at = 0;
    while (ring_.size() > 3) {
      const int n = static_cast<int>(ring_.size());
      at = NextEar(at % n);
      triangles.emplace_back(ring_[(at + n - 1) % n], ring_[at], ring_[(at + 1) % n]);
      ring_.erase(ring_.begin() + at);
    }
    if (ring_.size() == 3) triangles.emplace_back(ring_[0], ring_[1], ring_[2]);
    return triangles;
  }

 private:
  double Area(int a, int b, int c) const {
    return normal_.dot((points_[b] - points_[a]).cross(points_[c] - points_[a]));
  }

  bool IsEar(int a, int b, int c) const {
    return std::none_of(ring_.begin(), ring_.end(), [&](int p) {
      // The two sides of a slit to a hole have the same corners: those do not lie in the way.
      if (points_[p] == points_[a] || points_[p] == points_[b] || points_[p] == points_[c]) {
        return false;
      }
      return Area(a, b, p) >= 0.0 && Area(b, c, p) >= 0.0 && Area(c, a, p) >= 0.0;
    });
  }

  // The first ear from `start` on; where none is left (flat rests, polygons that cross themselves)
  // the corner that cuts off least.
  int NextEar(int start) const {
    const int n = static_cast<int>(ring_.size());
    int least = start;
    double least_area = -1.0;
    for (int k = 0; k < n; ++k) {
      const int i = (start + k) % n;
      const int a = ring_[(i + n - 1) % n], b = ring_[i], c = ring_[(i + 1) % n];
      const double area = Area(a, b, c);
      if (area > 0.0 && IsEar(a, b, c)) return i;
      if (least_area < 0.0 || std::abs(area) < least_area) {
        least = i;
        least_area = std::abs(area);
      }
    }
    return least;
  }

  const std::vector<Eigen::Vector3d>& points_;
  std::vector<int> ring_;
  const Eigen::Vector3d normal_;
};

}  // namespace

std::vector<Eigen::Vector3i> TriangulatePolygon(const std::vector<Eigen::Vector3d>& points,
                                                std::vector<int> polygon) {
  if (polygon.size() < 3) return {};
  if (polygon.size() == 3) return {{polygon[0], polygon[1], polygon[2]}};
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // Newell's, over the whole polygon
  const Eigen::Vector3d origin = points[polygon[0]];
  for (size_t i = 0; i < polygon.size(); ++i) {
    normal +=
        (points[polygon[i]] - origin).cross(points[polygon[(i + 1) % polygon.size()]] - origin);
  }
  if (IsConvex(points, polygon, normal)) {
    std::vector<Eigen::Vector3i> fan;
    for (size_t i = 2; i < polygon.size(); ++i) {
      fan.emplace_back(polygon[0], polygon[i - 1], polygon[i]);
    }
    return fan;
  }
  if (polygon.size() > static_cast<size_t>(kMaxConcaveCorners)) return {};
  return EarClipper(points, polygon, normal).Clip();
}

}  // namespace horopter
