#include "server/vision/euclidean/plane_cells.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "server/vision/euclidean/edge_points.h"
#include "server/vision/euclidean/plane_points.h"
#include "server/vision/euclidean/robust_scatter.h"

namespace horopter {
namespace {

constexpr double kOutlierSigmas = 3.0;  // of the scatter; further ones are left out of a cell
constexpr int kTrims = 2;               // of outliers
constexpr double kLeastSigmaPx = 0.02;  // of one match
// A match's offset is stored times its information: what is asked back along the edges of its patch
// is bounded by this.
constexpr double kLeastInformation = 0.002;
constexpr double kNoInformation = 1e-6;  // keeps matrices regular
constexpr double kAspect = 0.75;         // of an image, about
constexpr double kMostColumns = 12.0;    // of cells across an image: more hold single matches

// What a patch's structure says beyond `noise_share`, of its strongest direction.
Eigen::Matrix2d BeyondNoise(const Eigen::Matrix2d& structure, double noise_share) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(structure);
  const Eigen::Vector2d left =
      ((eigen.eigenvalues().array() - noise_share) / (1.0 - noise_share)).max(kNoInformation);
  return eigen.eigenvectors() * left.asDiagonal() * eigen.eigenvectors().transpose();
}

// Matches of a pair that lie in one cell of view a.
struct Heap {
  struct Match {
    Eigen::Vector2d a;
    Eigen::Vector2d offset;  // in b, from the pair's homography
    Eigen::Matrix2d information;
  };
  std::vector<Match> matches;
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();  // of the cell
  Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
  Eigen::Vector2d a = Eigen::Vector2d::Zero();  // mean
  int used = 0;

  // Squared distance of a match from the cell, in units of the noise across its edges.
  double SquaredOff(const Match& m) const {
    const Eigen::Vector2d e = m.offset - offset;
    return e.dot(m.information * e);
  }
  void Average(double most_squared) {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero(), middle = Eigen::Vector2d::Zero();
    Eigen::Matrix2d total = Eigen::Matrix2d::Zero();
    int count = 0;
    for (const Match& m : matches) {
      if (SquaredOff(m) > most_squared) continue;
      sum += m.information * m.offset;
      total += m.information;
      middle += m.a;
      ++count;
    }
    if (count == 0) return;
    offset = total.ldlt().solve(sum);
    information = total;
    a = middle / count;
    used = count;
  }
};

std::map<int, Heap> SortIntoCells(const PlaneHomography& pair, double cell_px, double noise_share) {
  std::map<int, Heap> heaps;
  const std::size_t n = std::min(pair.inliers_a.size(), pair.inliers_b.size());
  const bool weighted = pair.information.size() == n;
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector2d &a = pair.inliers_a[i], &b = pair.inliers_b[i];
    Heap::Match m{
        a, b - (pair.b_from_a * a.homogeneous()).hnormalized(), Eigen::Matrix2d::Identity()};
    if (weighted) {
      // The offset stored is the one found times the information.
      const Eigen::Matrix2d stored =
          pair.information[i] + kLeastInformation * Eigen::Matrix2d::Identity();
      m.offset = stored.ldlt().solve(m.offset);
      m.information = BeyondNoise(pair.information[i], noise_share);
    }
    if (!a.allFinite() || !m.offset.allFinite()) continue;
    constexpr int kStride = 1 << 12;  // columns fit below it
    const int cell = static_cast<int>(std::floor(a.y() / cell_px)) * kStride +
                     static_cast<int>(std::floor(a.x() / cell_px));
    heaps[cell].matches.push_back(m);
  }
  return heaps;
}

// Deviation of a match about its cell, across the edges of its patch.
double ScatterOf(const std::map<int, Heap>& heaps) {
  std::vector<double> squared;
  for (const auto& [cell, heap] : heaps) {
    const double n = static_cast<double>(heap.used);
    if (heap.used < 2) continue;
    for (const Heap::Match& m : heap.matches) squared.push_back(n / (n - 1.0) * heap.SquaredOff(m));
  }
  if (squared.empty()) return 1.0;
  const auto middle = squared.begin() + static_cast<long>(squared.size() / 2);
  std::nth_element(squared.begin(), middle, squared.end());
  return std::max(kLeastSigmaPx, std::sqrt(*middle / kMedianOfChiSquare2));
}

// Averages the heaps; returns the deviation of a match.
double AverageHeaps(std::map<int, Heap>* heaps) {
  for (auto& [index, heap] : *heaps) heap.Average(1e300);
  double scatter_px = 1.0;
  for (int trim = 0; trim < kTrims; ++trim) {
    scatter_px = ScatterOf(*heaps);
    const double most = kOutlierSigmas * kOutlierSigmas * scatter_px * scatter_px;
    for (auto& [index, heap] : *heaps) heap.Average(most);
  }
  return scatter_px;
}

// Symmetric square root of the inverse.
Eigen::Matrix2d InverseRoot(const Eigen::Matrix2d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(covariance);
  return eigen.operatorInverseSqrt();
}

}  // namespace

ObservedPlane AveragePlaneMatches(const MatchingResult& matching,
                                  const std::vector<std::optional<CalibratedCamera>>& views,
                                  const PlaneCellOptions& options) {
  const PlanePoints points = FindPlanePoints(matching, views);
  ObservedPlane out{points.plane, points.anchor, {}};
  if (points.matches.empty()) return out;
  std::vector<const PlaneHomography*> pairs;
  std::vector<bool> linked(views.size(), false);
  for (const PlaneHomography& pair : matching.planes) {
    if (!views[pair.view_a] || !views[pair.view_b]) continue;
    pairs.push_back(&pair);
    linked[pair.view_a] = linked[pair.view_b] = true;
  }
  const auto count = static_cast<double>(std::count(linked.begin(), linked.end(), true));
  const double repeated =
      std::max(1.0, static_cast<double>(pairs.size()) / std::max(1.0, count - 1.0));
  const double most_columns =
      std::sqrt(options.max_cells / (kAspect * static_cast<double>(pairs.size())));
  for (const PlaneHomography* pair : pairs) {
    const double width_a = views[pair->view_a]->camera.width;
    const double floor_px =
        options.floor_px *
        std::max(1.0, views[pair->view_b]->camera.width / double{kAdjustmentWidth});
    const double filled = static_cast<double>(pair->inliers_a.size()) / options.matches_per_cell;
    const double columns =
        std::clamp(std::min(most_columns, std::sqrt(filled / kAspect)), 2.0, kMostColumns);
    auto heaps = SortIntoCells(*pair, std::max(8.0, width_a / columns), options.noise_share);
    const double scatter_px = AverageHeaps(&heaps);
    for (const auto& [index, heap] : heaps) {
      if (heap.used == 0) continue;
      const Eigen::Matrix2d covariance =
          repeated * (scatter_px * scatter_px * heap.information.inverse() +
                      floor_px * floor_px * Eigen::Matrix2d::Identity());
      const Eigen::Vector2d mapped = (pair->b_from_a * heap.a.homogeneous()).hnormalized();
      if (!covariance.allFinite() || !mapped.allFinite()) continue;
      out.cells.push_back({pair->view_a,
                           pair->view_b,
                           heap.a,
                           mapped + heap.offset,
                           InverseRoot(covariance),
                           heap.used});
    }
  }
  return out;
}

}  // namespace horopter
