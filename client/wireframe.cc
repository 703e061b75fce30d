#include "client/wireframe.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "client/polygon.h"

namespace horopter {
namespace {

// Two edges that meet at less are taken for one line: they fix no plane.
constexpr double kMinCornerSine = 0.05;

using Loop = std::vector<int>;
using Neighbours = std::vector<std::vector<int>>;

struct Plane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset = 0.0;  // normal . x = offset
  double Distance(const Eigen::Vector3d& p) const { return std::abs(normal.dot(p) - offset); }
};

// The different planes of all corners, i.e. pairs of edges that meet.
std::vector<Plane> CornerPlanes(const Wireframe& w,
                                const Neighbours& neighbours,
                                double tolerance) {
  std::vector<Plane> planes;
  for (size_t v = 0; v < w.points.size(); ++v) {
    for (size_t i = 0; i < neighbours[v].size(); ++i) {
      for (size_t k = i + 1; k < neighbours[v].size(); ++k) {
        const Eigen::Vector3d& p = w.points[v];
        const Eigen::Vector3d &a = w.points[neighbours[v][i]], &b = w.points[neighbours[v][k]];
        const Eigen::Vector3d cross = (a - p).cross(b - p);
        if (!(cross.norm() > kMinCornerSine * (a - p).norm() * (b - p).norm())) continue;
        const Plane plane{cross.normalized(), cross.normalized().dot(p)};
        const bool known = std::any_of(planes.begin(), planes.end(), [&](const Plane& other) {
          return other.Distance(p) <= tolerance && other.Distance(a) <= tolerance &&
                 other.Distance(b) <= tolerance;
        });
        if (!known) planes.push_back(plane);
      }
    }
  }
  return planes;
}

// The closed loops of one plane.
class PlaneLoops {
 public:
  PlaneLoops(const Wireframe& w, const Plane& plane, double tolerance) {
    const Eigen::Vector3d x = plane.normal.unitOrthogonal(), y = plane.normal.cross(x);
    for (const Eigen::Vector3d& p : w.points) flat_.emplace_back(p.dot(x), p.dot(y));
    for (const auto& [a, b] : w.edges) {
      if (plane.Distance(w.points[a]) > tolerance || plane.Distance(w.points[b]) > tolerance) {
        continue;
      }
      next_[a].push_back(b);
      next_[b].push_back(a);
    }
    DropLooseEnds();
    for (auto& [v, list] : next_) {
      std::sort(list.begin(), list.end(), [&, at = v](int a, int b) {
        return Angle(at, a) < Angle(at, b);
      });
    }
    Trace();
  }

  // Faces: the outer loop first, then its holes.
  std::vector<std::vector<Loop>> Faces() const {
    std::vector<std::vector<Loop>> faces;
    for (const Loop& loop : inner_) {
      // How many other pieces' borders lie around it: odd inside a hole.
      int depth = 0;
      for (const Loop& border : borders_) {
        if (!Touches(border, loop) && Inside(flat_[loop[0]], border)) ++depth;
      }
      if (depth % 2 == 1) continue;
      std::vector<Loop> face{loop};
      for (const Loop& border : borders_) {
        if (Touches(border, loop) || !Inside(flat_[border[0]], loop)) continue;
        int between = 0;  // borders inside this loop around that one
        for (const Loop& other : borders_) {
          between += &other != &border && !Touches(other, loop) && !Touches(other, border) &&
                     Inside(flat_[other[0]], loop) && Inside(flat_[border[0]], other);
        }
        if (between == 0) face.push_back(border);
      }
      faces.push_back(std::move(face));
    }
    return faces;
  }

  // One polygon: every hole is joined to what is there already by a bridge that crosses nothing.
  Loop Joined(const std::vector<Loop>& face) const {
    Loop polygon = face[0];
    for (size_t h = 1; h < face.size(); ++h) {
      const Loop& hole = face[h];
      double shortest = INFINITY;
      size_t from = 0, to = 0;
      for (size_t i = 0; i < polygon.size(); ++i) {
        for (size_t k = 0; k < hole.size(); ++k) {
          const double length = (flat_[polygon[i]] - flat_[hole[k]]).norm();
          if (length < shortest && !Crosses(polygon[i], hole[k], face)) {
            shortest = length, from = i, to = k;
          }
        }
      }
      if (!std::isfinite(shortest)) continue;
      Loop joined(polygon.begin(), polygon.begin() + static_cast<long>(from) + 1);
      for (size_t k = 0; k <= hole.size(); ++k) joined.push_back(hole[(to + k) % hole.size()]);
      joined.insert(joined.end(), polygon.begin() + static_cast<long>(from), polygon.end());
      polygon = std::move(joined);
    }
    return polygon;
  }

 private:
  double Angle(int from, int to) const {
    const Eigen::Vector2d d = flat_[to] - flat_[from];
    return std::atan2(d.y(), d.x());
  }

  void DropLooseEnds() {
    for (bool changed = true; changed;) {
      changed = false;
      for (auto it = next_.begin(); it != next_.end();) {
        if (it->second.size() > 1) {
          ++it;
          continue;
        }
        for (const int other : it->second) std::erase(next_[other], it->first);
        it = next_.erase(it);
        changed = true;
      }
    }
  }

  // Every directed edge belongs to one loop that turns as sharply left as it can: counter-clockwise
  // ones bound a region from inside, clockwise ones a whole piece from outside.
  void Trace() {
    std::map<std::pair<int, int>, bool> used;
    for (const auto& [v, list] : next_) {
      for (const int first : list) {
        if (used[{v, first}]) continue;
        Loop loop;
        double area = 0.0;
        int a = v, b = first;
        while (!used[{a, b}]) {
          used[{a, b}] = true;
          loop.push_back(a);
          area += flat_[a].x() * flat_[b].y() - flat_[b].x() * flat_[a].y();
          const std::vector<int>& turn = next_.at(b);
          const auto back = std::find(turn.begin(), turn.end(), a);
          const int c = back == turn.begin() ? turn.back() : *(back - 1);
          a = b, b = c;
        }
        (area > 0.0 ? inner_ : borders_).push_back(std::move(loop));
      }
    }
  }

  static bool Touches(const Loop& a, const Loop& b) {
    return std::any_of(
        a.begin(), a.end(), [&](int v) { return std::find(b.begin(), b.end(), v) != b.end(); });
  }

  bool Inside(const Eigen::Vector2d& p, const Loop& loop) const {
    bool inside = false;
    for (size_t i = 0, k = loop.size() - 1; i < loop.size(); k = i++) {
      const Eigen::Vector2d &a = flat_[loop[i]], &b = flat_[loop[k]];
      if ((a.y() > p.y()) != (b.y() > p.y()) &&
          p.x() < a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x())) {
        inside = !inside;
      }
    }
    return inside;
  }

  bool Crosses(int i, int k, const std::vector<Loop>& face) const {
    const auto side =
        [](const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& p) {
          return (b - a).x() * (p - a).y() - (b - a).y() * (p - a).x();
        };
    const Eigen::Vector2d &p = flat_[i], &q = flat_[k];
    for (const Loop& loop : face) {
      for (size_t e = 0; e < loop.size(); ++e) {
        const int a = loop[e], b = loop[(e + 1) % loop.size()];
        if (a == i || a == k || b == i || b == k) continue;
        if (side(p, q, flat_[a]) * side(p, q, flat_[b]) <= 0.0 &&
            side(flat_[a], flat_[b], p) * side(flat_[a], flat_[b], q) <= 0.0) {
          return true;
        }
      }
    }
    return false;
  }

  std::vector<Eigen::Vector2d> flat_;     // all points in the plane's coordinates
  std::map<int, std::vector<int>> next_;  // neighbours in the plane, by angle
  std::vector<Loop> inner_;
  std::vector<Loop> borders_;
};

}  // namespace

WireframeSurface SurfaceOfWireframe(const Wireframe& wireframe, double tolerance) {
  Neighbours neighbours(wireframe.points.size());
  for (const auto& [a, b] : wireframe.edges) {
    neighbours[a].push_back(b);
    neighbours[b].push_back(a);
  }
  WireframeSurface surface;
  surface.mesh.vertices = wireframe.points;
  std::map<std::pair<int, int>, int> faces_of_edge;
  for (const auto& [a, b] : wireframe.edges) faces_of_edge[std::minmax(a, b)] = 0;
  for (const Plane& plane : CornerPlanes(wireframe, neighbours, tolerance)) {
    const PlaneLoops loops(wireframe, plane, tolerance);
    for (const std::vector<Loop>& face : loops.Faces()) {
      ++surface.faces;
      for (const Loop& loop : face) {
        for (size_t i = 0; i < loop.size(); ++i) {
          ++faces_of_edge[std::minmax(loop[i], loop[(i + 1) % loop.size()])];
        }
      }
      const auto triangles = TriangulatePolygon(wireframe.points, loops.Joined(face));
      surface.mesh.triangles.insert(
          surface.mesh.triangles.end(), triangles.begin(), triangles.end());
    }
  }
  for (const auto& [edge, faces] : faces_of_edge) surface.open_edges += faces != 2;
  return surface;
}

}  // namespace horopter
