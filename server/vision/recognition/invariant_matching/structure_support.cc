#include "server/vision/recognition/invariant_matching/structure_support.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "server/base/constants.h"
#include "server/vision/invariants/line_sets.h"

namespace horopter {
namespace {

// Chi-square of a matched vertex, 3 degrees of freedom. Wide: first-order covariances have heavy
// tails, and the score counts misfit anyway.
constexpr double kVertexGate = 25.0;
constexpr double kEdgeGate = 9.0;  // mean squared distance of an edge's ends, in sigmas
// Log-likelihood ratio against "something else stands there", of a vertex on a point: of the space
// a point may lie in to the one it is known to.
constexpr double kVertexGain = 6.0;
constexpr double kVertexMissing = -1.2;  // ... of a vertex without one: of being missed
constexpr double kEdgeGain = 2.5;        // ... of an edge on one
constexpr double kEdgeMissing = -0.5;    // ... of an edge without one
// Of two matched points that the scene joins and the model does not
constexpr double kEdgeContradicted = -3.0;
constexpr double kEdgeUnseen = -0.5;  // ... and the reverse
// First match of a rough transformation: distance of vertex and point, of the object's extent in
// the structure.
constexpr double kRoughReach = 0.10;
// Between invariants of sets of four vertices and an edge (thesis 4.2)
constexpr double kLineSetRad = 0.15;
// Vertices that determine a transformation, and one more that confirms it.
int MinVertices(TransformGroup group) {
  return group == TransformGroup::kCollineation ? 6 : 5;
}

struct Mapped {
  std::vector<Eigen::Vector3d> vertices;
  bool finite = false;  // all on one side of the plane at infinity
};
Mapped MapShape(const ObjectShape& shape, const Eigen::Matrix4d& H) {
  Mapped out;
  for (const auto& v : shape.vertices) {
    const Eigen::Vector4d y = H * v.homogeneous();
    if (!(y.w() > 0.0)) return out;
    out.vertices.push_back(y.hnormalized());
  }
  out.finite = !out.vertices.empty();
  return out;
}

struct Pair {
  double cost;
  VertexMatch match;
};

// Cheapest pairs first, none twice.
std::vector<VertexMatch> OneToOne(std::vector<Pair> pairs, int vertices, std::size_t points) {
  std::stable_sort(
      pairs.begin(), pairs.end(), [](const Pair& a, const Pair& b) { return a.cost < b.cost; });
  std::vector<bool> vertex_used(vertices, false), point_used(points, false);
  std::vector<VertexMatch> out;
  for (const Pair& p : pairs) {
    if (vertex_used[p.match.vertex] || point_used[p.match.point]) continue;
    vertex_used[p.match.vertex] = point_used[p.match.point] = true;
    out.push_back(p.match);
  }
  return out;
}

std::vector<VertexMatch> MatchWithin(const StructureEvidence& evidence,
                                     const Mapped& mapped,
                                     double reach,
                                     double chi2_gate) {
  const SceneStructure& s = *evidence.structure;
  std::vector<Pair> pairs;
  for (int v = 0; v < static_cast<int>(mapped.vertices.size()); ++v) {
    for (int i = 0; i < static_cast<int>(s.points.size()); ++i) {
      const Eigen::Vector3d e = mapped.vertices[v] - s.points[i];
      if (!(e.squaredNorm() < reach * reach)) continue;
      const double chi2 = e.dot(evidence.information[i] * e);
      if (chi2 < chi2_gate) pairs.push_back({std::isfinite(chi2_gate) ? chi2 : e.norm(), {v, i}});
    }
  }
  return OneToOne(std::move(pairs), static_cast<int>(mapped.vertices.size()), s.points.size());
}

std::vector<EdgeMatch> MatchEdges(const StructureEvidence& evidence,
                                  const ObjectShape& shape,
                                  const Mapped& mapped,
                                  const Eigen::Matrix4d& H,
                                  double gate,
                                  std::vector<double>* chi2) {
  const SceneStructure& s = *evidence.structure;
  std::vector<EdgeMatch> out;
  std::vector<bool> used(s.lines.size(), false);
  for (int e = 0; e < static_cast<int>(shape.edges.size()); ++e) {
    const auto& [a, b] = shape.edges[e];
    const Eigen::Vector3d from = mapped.vertices[a], along = mapped.vertices[b] - from;
    double best = gate;
    int line = -1;
    for (int j = 0; j < static_cast<int>(s.lines.size()); ++j) {
      if (used[j] || evidence.observations_of_line[j].empty()) continue;
      // What was seen of the line must be of the edge, not of its continuation.
      const Eigen::Vector3d to = evidence.line_middle[j] - from;
      const double share = to.dot(along) / along.squaredNorm();
      if (!(share > -0.1 && share < 1.1)) continue;
      if (!((to - share * along).norm() < 0.2 * along.norm())) continue;
      const double misfit =
          EdgeChi2(s, evidence.observations_of_line, H, shape.vertices[a], shape.vertices[b], j);
      if (misfit < best) best = misfit, line = j;
    }
    if (line < 0) continue;
    used[line] = true;
    out.push_back({e, line});
    chi2->push_back(best);
  }
  return out;
}

// Edges between matched points that scene and model agree on, or not.
double EdgeAgreement(const StructureEvidence& evidence,
                     const ObjectShape& shape,
                     std::span<const VertexMatch> matches) {
  double sum = 0.0;
  for (std::size_t k = 0; k < matches.size(); ++k) {
    for (std::size_t l = 0; l < k; ++l) {
      const bool scene = evidence.joined[matches[k].point][matches[l].point];
      const bool model = shape.joined[matches[k].vertex][matches[l].vertex];
      if (scene && !model) sum += kEdgeContradicted;
      if (model && !scene) sum += kEdgeUnseen;
    }
  }
  return sum;
}

}  // namespace

StructureEvidence GatherEvidence(const SceneStructure& structure) {
  StructureEvidence out;
  out.structure = &structure;
  out.information = PointInformation(structure);
  out.joined.assign(structure.points.size(), std::vector<bool>(structure.points.size(), false));
  for (const auto& [a, b] : structure.edges) out.joined[a][b] = out.joined[b][a] = true;
  out.observations_of_line = ObservationsOfLines(structure);
  for (std::size_t j = 0; j < structure.lines.size(); ++j) {
    // Where the ray through the middle of an observation meets the line; mean over the views.
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    int n = 0;
    for (const int k : out.observations_of_line[j]) {
      const LineObservation& o = structure.line_observations[k];
      const CameraMatrix& P = *structure.cameras[o.view];
      // A plane through the centre that cuts the image line across at the middle.
      const Eigen::Vector2d middle = 0.5 * (o.start + o.end), along = o.end - o.start;
      const Eigen::Vector3d across(along.x(), along.y(), -along.dot(middle));
      const Eigen::Vector4d X =
          MeetLinePlane(structure.lines[j], BackProjectLine(P, across / along.norm()));
      const Eigen::Vector3d x = X.hnormalized();
      if (!x.allFinite()) continue;
      sum += x;
      ++n;
    }
    out.line_middle.push_back(n > 0 ? Eigen::Vector3d(sum / n)
                                    : Eigen::Vector3d::Constant(kInfinity));
  }
  return out;
}

std::vector<VertexMatch> QuickVertexMatches(const SceneStructure& structure,
                                            std::span<const int> points,
                                            const ObjectShape& shape,
                                            const Eigen::Matrix4d& structure_from_shape,
                                            double reach) {
  std::vector<VertexMatch> out;
  std::vector<bool> used(structure.points.size(), false);
  for (int v = 0; v < shape.size(); ++v) {
    const Eigen::Vector4d y = structure_from_shape * shape.vertices[v].homogeneous();
    if (!(y.w() > 0.0)) return {};
    const Eigen::Vector3d x = y.hnormalized();
    double best = reach * reach;
    int at = -1;
    for (const int i : points) {
      const double d = (structure.points[i] - x).squaredNorm();
      if (d < best && !used[i]) best = d, at = i;
    }
    if (at < 0) continue;
    used[at] = true;
    out.push_back({v, at});
  }
  return out;
}

double MappedExtent(const ObjectShape& shape, const Eigen::Matrix4d& structure_from_shape) {
  const Mapped mapped = MapShape(shape, structure_from_shape);
  if (!mapped.finite) return kInfinity;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  const auto n = static_cast<double>(mapped.vertices.size());
  for (const auto& x : mapped.vertices) mean += x / n;
  double sum = 0.0;
  for (const auto& x : mapped.vertices) sum += (x - mean).squaredNorm() / n;
  return std::sqrt(sum);
}

bool IsSeenUnmirrored(const SceneStructure& structure,
                      const ObjectShape& shape,
                      const Eigen::Matrix4d& structure_from_shape) {
  int proper = 0;
  for (const auto& P : structure.cameras) {
    if (!P) continue;
    const CameraMatrix in_shape = *P * structure_from_shape;
    int front = 0;
    for (const auto& v : shape.vertices)
      front += in_shape.row(2).dot(v.homogeneous()) > 0.0 ? 1 : -1;
    const double det = in_shape.leftCols<3>().determinant();
    proper += det * front > 0.0 ? 1 : -1;
  }
  return proper > 0;
}

bool LineSetsAgree(const SceneStructure& structure,
                   const ObjectShape& shape,
                   std::span<const VertexMatch> vertices,
                   std::span<const EdgeMatch> edges,
                   double tolerance_rad) {
  int sets = 0, agreeing = 0;
  for (const EdgeMatch& e : edges) {
    const auto [a, b] = shape.edges[e.edge];
    std::vector<VertexMatch> beside;
    for (const VertexMatch& m : vertices) {
      if (m.vertex != a && m.vertex != b) beside.push_back(m);
    }
    const Vector6d of_model =
        LineThrough(shape.vertices[a].homogeneous(), shape.vertices[b].homogeneous());
    for (std::size_t first = 0; first + 4 <= beside.size(); ++first) {
      std::array<Eigen::Vector4d, 4> points, model;
      for (int i = 0; i < 4; ++i) {
        points[i] = structure.points[beside[first + i].point].homogeneous();
        model[i] = shape.vertices[beside[first + i].vertex].homogeneous();
      }
      const auto of_scene = FourPointsOneLine(points, structure.lines[e.line]);
      const auto of_object = FourPointsOneLine(model, of_model);
      if (!of_scene || !of_object) continue;
      ++sets;
      agreeing += std::abs(of_scene->values(0) - of_object->values(0)) < tolerance_rad;
    }
  }
  return 2 * agreeing >= sets;
}

StructureHypothesis JudgeTransform(TransformGroup group,
                                   const StructureEvidence& evidence,
                                   const ObjectShape& shape,
                                   const Eigen::Matrix4d& structure_from_shape,
                                   const SupportOptions& options) {
  StructureHypothesis out;
  out.log_odds = -kInfinity;
  Eigen::Matrix4d H = structure_from_shape;
  const SceneStructure& structure = *evidence.structure;
  Mapped mapped = MapShape(shape, H);
  if (!mapped.finite) return out;
  double reach = kRoughReach * MappedExtent(shape, H);
  double gate = kInfinity;
  for (int round = 0; round < options.rounds; ++round) {
    out.vertices = MatchWithin(evidence, mapped, reach, gate);
    if (static_cast<int>(out.vertices.size()) < MinVertices(group)) return out;
    H = RefineTransform(
        group, structure, evidence.information, shape, out.vertices, {}, options.refine, H);
    mapped = MapShape(shape, H);
    if (!mapped.finite) return out;
    // From the rough distance to the gate of first order.
    gate = round + 2 >= options.rounds ? kVertexGate : 4.0 * kVertexGate;
  }
  out.vertices = MatchWithin(evidence, mapped, reach, kVertexGate);
  if (static_cast<int>(out.vertices.size()) < MinVertices(group)) return out;
  if (!IsSeenUnmirrored(structure, shape, H)) return out;
  std::vector<double> edge_chi2;
  out.edges = MatchEdges(evidence, shape, mapped, H, kEdgeGate, &edge_chi2);
  if (options.check_line_sets &&
      !LineSetsAgree(structure, shape, out.vertices, out.edges, kLineSetRad)) {
    return out;
  }

  double sum = 0.0, chi2_sum = 0.0;
  for (const VertexMatch& m : out.vertices) {
    const double chi2 = VertexChi2(
        H, shape.vertices[m.vertex], structure.points[m.point], evidence.information[m.point]);
    chi2_sum += chi2;
    sum += std::max(kVertexMissing, kVertexGain - 0.5 * chi2);
  }
  const double matched = static_cast<double>(out.vertices.size());
  sum += kVertexMissing * (shape.size() - matched);
  for (const double chi2 : edge_chi2) {
    sum += std::max(kEdgeMissing, kEdgeGain - 0.5 * chi2);
  }
  sum += kEdgeMissing * static_cast<double>(shape.edges.size() - out.edges.size());
  sum += EdgeAgreement(evidence, shape, out.vertices);
  out.log_odds = sum;
  out.rms_sigma = std::sqrt(chi2_sum / (3.0 * matched));
  out.structure_from_object = H * shape.unit_from_object;
  return out;
}

}  // namespace horopter
