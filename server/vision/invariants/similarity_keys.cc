#include "server/vision/invariants/similarity_keys.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>

namespace horopter {
namespace {

constexpr int kPairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};  // of four points

// Rows: Helmert's basis of the complement of (1, .., 1) in R^6.
Eigen::Matrix<double, 5, 6> HelmertBasis() {
  Eigen::Matrix<double, 5, 6> basis = Eigen::Matrix<double, 5, 6>::Zero();
  for (int r = 0; r < 5; ++r) {
    const double norm = std::sqrt((r + 1.0) * (r + 2.0));
    for (int c = 0; c <= r; ++c) basis(r, c) = 1.0 / norm;
    basis(r, r + 1) = -(r + 1.0) / norm;
  }
  return basis;
}

std::vector<std::vector<int>> Neighbours(const ObjectModel& model) {
  std::vector<std::set<int>> sets(model.vertices.size());
  for (const ModelEdge& edge : model.edges) {
    if (edge.kind != CurveKind::kLine || edge.start_vertex < 0 || edge.end_vertex < 0 ||
        edge.start_vertex == edge.end_vertex) {
      continue;
    }
    sets[edge.start_vertex].insert(edge.end_vertex);
    sets[edge.end_vertex].insert(edge.start_vertex);
  }
  std::vector<std::vector<int>> neighbours;
  for (const std::set<int>& s : sets) neighbours.emplace_back(s.begin(), s.end());
  return neighbours;
}

// Volume over the cube of the longest edge below which four points count as coplanar.
constexpr double kFlat = 1e-3;

}  // namespace

std::vector<FourVertices> VertexChains(const ObjectModel& model) {
  const std::vector<std::vector<int>> neighbours = Neighbours(model);
  std::vector<FourVertices> chains;
  for (int b = 0; b < static_cast<int>(neighbours.size()); ++b) {
    for (const int c : neighbours[b]) {
      if (c < b) continue;  // the middle edge in one direction: each chain once
      for (const int a : neighbours[b]) {
        if (a == c) continue;
        for (const int d : neighbours[c]) {
          if (d != a && d != b) chains.push_back({a, b, c, d});
        }
      }
    }
  }
  return chains;
}

std::vector<FourVertices> VertexStars(const ObjectModel& model) {
  const std::vector<std::vector<int>> neighbours = Neighbours(model);
  std::vector<FourVertices> stars;
  for (int v = 0; v < static_cast<int>(neighbours.size()); ++v) {
    const std::vector<int>& n = neighbours[v];
    for (size_t i = 0; i < n.size(); ++i) {
      for (size_t j = i + 1; j < n.size(); ++j) {
        for (size_t k = j + 1; k < n.size(); ++k) stars.push_back({v, n[i], n[j], n[k]});
      }
    }
  }
  return stars;
}

std::optional<SimilarityKey> SimilarityKeyOf(std::span<const Eigen::Vector3d, 4> points,
                                             const Eigen::MatrixXd& covariance,
                                             const SimilarityKeyOptions& options) {
  Vector6d logs;
  Eigen::Matrix<double, 6, 12> jacobian = Eigen::Matrix<double, 6, 12>::Zero();
  double least = INFINITY, most = 0.0;
  for (int p = 0; p < 6; ++p) {
    const int i = kPairs[p][0], j = kPairs[p][1];
    const Eigen::Vector3d difference = points[i] - points[j];
    const double squared = difference.squaredNorm();
    least = std::min(least, std::sqrt(squared));
    most = std::max(most, std::sqrt(squared));
    logs(p) = 0.5 * std::log(squared);
    jacobian.block<1, 3>(p, 3 * i) = difference.transpose() / squared;
    jacobian.block<1, 3>(p, 3 * j) = -difference.transpose() / squared;
  }
  if (!(most > 0.0) || !std::isfinite(most) || least < options.min_distance_ratio * most) {
    return std::nullopt;
  }
  static const Eigen::Matrix<double, 5, 6> kHelmert = HelmertBasis();
  SimilarityKey result;
  result.key.values = kHelmert * logs;
  result.log_size = logs.mean();
  if (covariance.size() > 0) {
    const Eigen::Matrix<double, 6, 6> of_logs = jacobian * covariance * jacobian.transpose();
    const double deviation = std::sqrt(of_logs.diagonal().mean());
    if (!(deviation <= options.max_log_deviation)) return std::nullopt;
    result.key.covariance = kHelmert * of_logs * kHelmert.transpose();
  }
  Eigen::Matrix3d frame;
  for (int i = 0; i < 3; ++i) frame.col(i) = points[i + 1] - points[0];
  const double volume = frame.determinant() / (most * most * most);
  result.handedness = volume > kFlat ? 1 : volume < -kFlat ? -1 : 0;
  return result;
}

}  // namespace horopter
