#include "client/edge_chains.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

namespace horopter {
namespace {

constexpr double kMaxTurn = 38.0 * M_PI / 180.0;
constexpr double kMaxLengthRatio = 3.0;

using Points = std::vector<Eigen::Vector3d>;

double Turn(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const Eigen::Vector3d u = b - a, v = c - b;
  return std::atan2(u.cross(v).norm(), u.dot(v));
}

// Maximal chains of the edge graph through vertices of degree two that turn by at most kMaxTurn.
std::vector<std::vector<int>> SmoothChains(const Points& points,
                                           const std::vector<std::pair<int, int>>& edges) {
  std::map<int, std::vector<int>> incident;  // ordered: the result does not depend on hashing
  for (int e = 0; e < static_cast<int>(edges.size()); ++e) {
    incident[edges[e].first].push_back(e);
    incident[edges[e].second].push_back(e);
  }
  const auto other = [&](int e, int v) {
    return edges[e].first == v ? edges[e].second : edges[e].first;
  };
  const auto passes = [&](int v) {
    const auto& list = incident[v];
    return list.size() == 2 &&
           Turn(points[other(list[0], v)], points[v], points[other(list[1], v)]) <= kMaxTurn;
  };
  std::vector<bool> used(edges.size(), false);
  std::vector<std::vector<int>> chains;
  const auto walk = [&](int start_edge, int from) {
    std::vector<int> chain{from};
    for (int e = start_edge, v = from; e >= 0;) {
      used[e] = true;
      v = other(e, v);
      chain.push_back(v);
      if (!passes(v)) break;
      const auto& list = incident[v];
      const int next = list[0] == e ? list[1] : list[0];
      e = used[next] ? -1 : next;
    }
    chains.push_back(std::move(chain));
  };
  for (const auto& [v, list] : incident) {
    if (passes(v)) continue;
    for (const int e : list) {
      if (!used[e]) walk(e, v);
    }
  }
  for (int e = 0; e < static_cast<int>(edges.size()); ++e) {
    if (!used[e]) walk(e, edges[e].first);  // closed, smooth everywhere
  }
  return chains;
}

// Whether chain[first..last] lies on one circle with comparable steps.
bool IsArc(const Points& points, const std::vector<int>& chain, int first, int last, double tol) {
  if (last - first < 3) return false;
  Points run;
  double shortest = 1e300, longest = 0.0;
  for (int i = first; i <= last; ++i) {
    run.push_back(points[chain[i]]);
    if (i > first) {
      const double length = (run[run.size() - 1] - run[run.size() - 2]).norm();
      shortest = std::min(shortest, length);
      longest = std::max(longest, length);
    }
  }
  return longest <= kMaxLengthRatio * shortest && CircleThrough(run, tol).has_value();
}

double LargestTurn(const Points& points, const std::vector<int>& v) {
  double turn = 0.0;
  for (size_t i = 1; i + 1 < v.size(); ++i) {
    turn = std::max(turn, Turn(points[v[i - 1]], points[v[i]], points[v[i + 1]]));
  }
  return turn;
}

// Rotates a closed chain so that it starts where an arc begins.
void StartAtBreak(const Points& points, std::vector<int>& chain, double tol) {
  const int n = static_cast<int>(chain.size()) - 1;
  const auto arc_from = [&](int i) {
    const std::vector<int> window{
        chain[i % n], chain[(i + 1) % n], chain[(i + 2) % n], chain[(i + 3) % n]};
    return IsArc(points, window, 0, 3, tol);
  };
  for (int i = 1; i <= n; ++i) {
    if (arc_from(i - 1) || !arc_from(i)) continue;
    chain.pop_back();
    std::rotate(chain.begin(), chain.begin() + i % n, chain.end());
    chain.push_back(chain.front());
    return;
  }
}

// Joined copy of two edges meeting at `vertex`.
ModelEdge Join(ModelEdge first, ModelEdge second, int vertex) {
  if (first.end_vertex != vertex) {
    std::swap(first.start_vertex, first.end_vertex);
    std::reverse(first.polyline.begin(), first.polyline.end());
  }
  if (second.start_vertex != vertex) {
    std::swap(second.start_vertex, second.end_vertex);
    std::reverse(second.polyline.begin(), second.polyline.end());
  }
  const auto length = [](const Points& p) {
    double sum = 0.0;
    for (size_t i = 1; i < p.size(); ++i) sum += (p[i] - p[i - 1]).norm();
    return sum;
  };
  const double l1 = length(first.polyline), l2 = length(second.polyline);
  first.dihedral_rad = (l1 * first.dihedral_rad + l2 * second.dihedral_rad) / (l1 + l2);
  if (first.kind == CurveKind::kLine) {
    first.polyline = {first.polyline.front(), second.polyline.back()};
  } else {
    first.polyline.insert(first.polyline.end(), second.polyline.begin() + 1, second.polyline.end());
  }
  first.end_vertex = second.end_vertex;
  if (first.start_vertex == first.end_vertex) {
    first.start_vertex = first.end_vertex = -1;
    first.polyline.back() = first.polyline.front();
  }
  return first;
}

bool Joinable(const ModelEdge& a, const ModelEdge& b, int vertex, double tol) {
  if (a.kind != b.kind || a.kind == CurveKind::kOther) return false;
  // The joint must be passed through, not turned back at.
  const auto away = [&](const ModelEdge& e) -> Eigen::Vector3d {
    const Points& p = e.polyline;
    return e.start_vertex == vertex ? p[1] - p[0] : p[p.size() - 2] - p.back();
  };
  if (away(a).dot(away(b)) >= 0.0) return false;
  Points joined = a.polyline;
  if (a.end_vertex != vertex) std::reverse(joined.begin(), joined.end());
  Points rest = b.polyline;
  if (b.start_vertex != vertex) std::reverse(rest.begin(), rest.end());
  joined.insert(joined.end(), rest.begin() + 1, rest.end());
  if (a.kind == CurveKind::kLine) return AllOnLine(joined, tol);
  return CircleThrough(joined, tol).has_value();
}

}  // namespace

bool AllOnLine(std::span<const Eigen::Vector3d> points, double tolerance) {
  const Eigen::Vector3d d = points.back() - points.front();
  if (d.norm() <= tolerance) return false;
  const Eigen::Vector3d u = d.normalized();
  return std::all_of(points.begin(), points.end(), [&](const Eigen::Vector3d& p) {
    return (p - points.front()).cross(u).norm() <= tolerance;
  });
}

std::optional<Circle3> CircleThrough(std::span<const Eigen::Vector3d> points, double tolerance) {
  const size_t n = points.size();
  if (n < 3) return std::nullopt;
  const bool closed = (points.front() - points.back()).norm() <= tolerance;
  const Eigen::Vector3d a = points[0];
  const Eigen::Vector3d b = points[closed ? n / 3 : n / 2];
  const Eigen::Vector3d c = points[closed ? (2 * n) / 3 : n - 1];
  const Eigen::Vector3d u = b - a, v = c - a, w = u.cross(v);
  // Sagitta below the tolerance: the points do not tell a circle from a line.
  if (w.norm() <= tolerance * v.norm()) return std::nullopt;
  Circle3 circle;
  circle.center =
      a + (v.squaredNorm() * w.cross(u) + u.squaredNorm() * v.cross(w)) / (2.0 * w.squaredNorm());
  circle.normal = w.normalized();
  circle.radius = (a - circle.center).norm();
  for (const Eigen::Vector3d& p : points) {
    const Eigen::Vector3d r = p - circle.center;
    if (std::abs(r.dot(circle.normal)) > tolerance ||
        std::abs(r.norm() - circle.radius) > tolerance) {
      return std::nullopt;
    }
  }
  return circle;
}

std::vector<ArcRun> FindArcRuns(const std::vector<Eigen::Vector3d>& points,
                                const std::vector<std::pair<int, int>>& edges,
                                double tolerance) {
  std::vector<ArcRun> runs;
  for (std::vector<int>& chain : SmoothChains(points, edges)) {
    const int last = static_cast<int>(chain.size()) - 1;
    if (chain.front() == chain.back() && !IsArc(points, chain, 0, last, tolerance)) {
      StartAtBreak(points, chain, tolerance);
    }
    for (int i = 0; i + 3 <= last;) {
      int j = i + 3;
      if (!IsArc(points, chain, i, j, tolerance)) {
        ++i;
        continue;
      }
      while (j < last && IsArc(points, chain, i, j + 1, tolerance)) ++j;
      ArcRun run{{chain.begin() + i, chain.begin() + j + 1}, 0.0};
      run.largest_turn_rad = LargestTurn(points, run.vertices);
      runs.push_back(std::move(run));
      i = j;
    }
  }
  return runs;
}

void MergeSmoothJoints(ObjectModel& model, double tolerance) {
  std::map<int, std::vector<int>> incident;
  for (int e = 0; e < static_cast<int>(model.edges.size()); ++e) {
    if (model.edges[e].start_vertex < 0) continue;
    incident[model.edges[e].start_vertex].push_back(e);
    incident[model.edges[e].end_vertex].push_back(e);
  }
  std::vector<bool> gone(model.edges.size(), false);
  for (const auto& [v, list] : incident) {
    if (list.size() != 2) continue;
    const int keep = list[0], drop = list[1];
    if (keep ==
        drop) {  // a closed curve with one vertex that nothing else meets: a seam, not a corner
      model.edges[keep].start_vertex = model.edges[keep].end_vertex = -1;
      continue;
    }
    if (!Joinable(model.edges[keep], model.edges[drop], v, tolerance)) continue;
    model.edges[keep] = Join(model.edges[keep], model.edges[drop], v);
    gone[drop] = true;
    for (auto& [u, others] : incident) {
      if (u != v) std::replace(others.begin(), others.end(), drop, keep);
    }
  }
  std::vector<ModelEdge> kept;
  for (size_t e = 0; e < model.edges.size(); ++e) {
    if (gone[e]) continue;
    ModelEdge& edge = model.edges[e];
    if (edge.start_vertex == edge.end_vertex) edge.start_vertex = edge.end_vertex = -1;
    kept.push_back(std::move(edge));
  }
  model.edges = std::move(kept);
  DropUnusedVertices(model);
}

void DropUnusedVertices(ObjectModel& model) {
  std::vector<int> renumbered(model.vertices.size(), -1);
  for (const ModelEdge& e : model.edges) {
    if (e.start_vertex >= 0) renumbered[e.start_vertex] = renumbered[e.end_vertex] = 0;
  }
  std::vector<Eigen::Vector3d> kept;
  for (size_t v = 0; v < renumbered.size(); ++v) {
    if (renumbered[v] < 0) continue;
    renumbered[v] = static_cast<int>(kept.size());
    kept.push_back(model.vertices[v]);
  }
  for (ModelEdge& e : model.edges) {
    if (e.start_vertex < 0) continue;
    e.start_vertex = renumbered[e.start_vertex];
    e.end_vertex = renumbered[e.end_vertex];
  }
  model.vertices = std::move(kept);
}

}  // namespace horopter
