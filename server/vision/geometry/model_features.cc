#include "server/vision/geometry/model_features.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

namespace horopter {
namespace {

// Edges that share a vertex, transitively; the number of its group for each.
std::vector<int> GroupEdges(const ObjectModel& model) {
  std::vector<int> parent(model.vertices.size() + model.edges.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  const int vertices = static_cast<int>(model.vertices.size());
  for (int e = 0; e < static_cast<int>(model.edges.size()); ++e) {
    for (const int v : {model.edges[e].start_vertex, model.edges[e].end_vertex}) {
      if (v >= 0 && v < vertices) parent[root(v)] = root(vertices + e);
    }
  }
  std::vector<int> group(model.edges.size());
  for (int e = 0; e < static_cast<int>(group.size()); ++e) group[e] = root(vertices + e);
  return group;
}

// Whether most of a's points lie beside b's: rims of one chamfer, which light shows together.
bool IsBeside(const ModelFeature& a, const ModelFeature& b, double reach_m) {
  constexpr int kStride = 3;
  if ((a.place - b.place).norm() > 0.5 * (a.size_m + b.size_m) + reach_m) return false;
  int near = 0, asked = 0;
  for (std::size_t i = 0; i < a.points.size(); i += kStride, ++asked) {
    near += std::any_of(b.points.begin(), b.points.end(), [&](const Eigen::Vector3d& p) {
      return (p - a.points[i]).squaredNorm() < reach_m * reach_m;
    });
  }
  return 2 * near > asked;
}

// Of points in a plane about `place`; zero of others.
Eigen::Vector3d NormalOf(const ModelFeature& f) {
  constexpr double kFlat = 1e-3;  // of the variances
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& p : f.points) scatter += (p - f.place) * (p - f.place).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  if (!(eigen.eigenvalues()[0] < kFlat * eigen.eigenvalues()[1])) return Eigen::Vector3d::Zero();
  return eigen.eigenvectors().col(0);
}

// Whether one is the other shifted along its normal: the two rims of what goes through.
bool AreOpposite(const ModelFeature& a, const ModelFeature& b) {
  constexpr double kSameSize = 0.05, kSine = 0.05;
  if (std::abs(a.size_m - b.size_m) > kSameSize * a.size_m) return false;
  const Eigen::Vector3d normal = NormalOf(a), shift = b.place - a.place;
  return normal.cross(NormalOf(b)).norm() < kSine && !normal.isZero() &&
         shift.cross(normal).norm() < kSine * a.size_m;
}

// Features beside larger ones, or on the other side of them, become part of these. Largest first,
// before and after.
std::vector<ModelFeature> Joined(std::vector<ModelFeature> features, double reach_m) {
  std::vector<ModelFeature> out;
  for (ModelFeature& f : features) {
    const auto larger = std::find_if(out.begin(), out.end(), [&](const ModelFeature& other) {
      return IsBeside(f, other, reach_m) || AreOpposite(f, other);
    });
    if (larger == out.end()) {
      out.push_back(std::move(f));
    } else {
      larger->points.insert(larger->points.end(), f.points.begin(), f.points.end());
    }
  }
  return out;
}

void AddPoints(const ModelEdge& edge, double spacing_m, std::vector<Eigen::Vector3d>* points) {
  for (std::size_t i = 1; i < edge.polyline.size(); ++i) {
    const Eigen::Vector3d &a = edge.polyline[i - 1], &b = edge.polyline[i];
    const int steps = std::max(1, static_cast<int>(std::ceil((b - a).norm() / spacing_m)));
    for (int k = 0; k < steps; ++k) points->push_back(a + (b - a) * k / steps);
  }
}

}  // namespace

std::vector<ModelFeature> FindModelFeatures(const ObjectModel& model,
                                            const ModelFeatureOptions& options) {
  const double spacing_m = kFeatureSpacing * model.diameter_m;
  std::vector<ModelFeature> out;
  if (!(spacing_m > 0.0)) return out;
  const std::vector<int> group = GroupEdges(model);
  std::vector<int> order(group.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return group[a] < group[b]; });
  for (std::size_t i = 0; i < order.size();) {
    ModelFeature feature;
    Eigen::AlignedBox3d box;
    const int of = group[order[i]];
    for (; i < order.size() && group[order[i]] == of; ++i) {
      const ModelEdge& edge = model.edges[order[i]];
      for (const Eigen::Vector3d& p : edge.polyline) box.extend(p);
      AddPoints(edge, spacing_m, &feature.points);
    }
    feature.size_m = box.isEmpty() ? 0.0 : box.sizes().maxCoeff();
    if (feature.size_m < options.min_size * model.diameter_m ||
        feature.size_m > options.max_size * model.diameter_m)
      continue;
    feature.place = box.center();
    out.push_back(std::move(feature));
  }
  std::stable_sort(
      out.begin(), out.end(), [](const auto& a, const auto& b) { return a.size_m > b.size_m; });
  out = Joined(std::move(out), options.beside * model.diameter_m);
  if (static_cast<int>(out.size()) > options.most) out.resize(options.most);
  return out;
}

FeatureMap::FeatureMap(const std::vector<ModelFeature>& features, double diameter_m)
    : reach_m_(1.5 * kFeatureSpacing * diameter_m) {
  for (int f = 0; f < static_cast<int>(features.size()); ++f) {
    for (const Eigen::Vector3d& p : features[f].points) cells_.push_back({KeyOf(CellOf(p)), f, p});
  }
  std::stable_sort(
      cells_.begin(), cells_.end(), [](const Cell& a, const Cell& b) { return a.key < b.key; });
}

Eigen::Vector3i FeatureMap::CellOf(const Eigen::Vector3d& point) const {
  return (point / reach_m_).array().floor().cast<int>();
}

std::int64_t FeatureMap::KeyOf(const Eigen::Vector3i& cell) const {
  const auto wrapped = [](int x) { return static_cast<std::int64_t>(x & (kSide - 1)); };
  return (wrapped(cell.x()) * kSide + wrapped(cell.y())) * kSide + wrapped(cell.z());
}

int FeatureMap::At(const Eigen::Vector3d& point) const {
  if (cells_.empty()) return -1;
  const Eigen::Vector3i middle = CellOf(point);
  int best = -1;
  double nearest = reach_m_;
  for (int i = 0; i < 27; ++i) {
    const std::int64_t key = KeyOf(middle + Eigen::Vector3i(i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1));
    auto at = std::lower_bound(
        cells_.begin(), cells_.end(), key, [](const Cell& c, std::int64_t k) { return c.key < k; });
    for (; at != cells_.end() && at->key == key; ++at) {
      const double distance = (at->point - point).norm();
      if (distance > nearest) continue;
      nearest = distance;
      best = at->feature;
    }
  }
  return best;
}

}  // namespace horopter
