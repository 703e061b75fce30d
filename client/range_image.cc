// Point cloud -> planes -> edges -> corners.
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <random>
#include <set>
#include <unordered_map>

#include "absl/strings/str_cat.h"
#include "client/reconstruction_file.h"

namespace horopter {
namespace {

constexpr size_t kMinPoints = 200;
constexpr int kMaxPlanes = 80;
constexpr int kSeeds = 150;              // planes tried for each one found
constexpr double kNormalCos = 0.90;      // 25 degrees: normals of a noisy patch
constexpr double kMinDeterminant = 0.1;  // of three unit normals that fix a corner
constexpr double kMinPairSine = 0.26;    // 15 degrees between two planes that make an edge
// Radius of the neighbourhood that gives a point its normal, and distance from a corner or edge at
// which its planes must have points, in spacings: points nearer to an edge than the former have no
// normal.
constexpr double kNormalReach = 1.2;
constexpr double kSupportReach = 2.0;
constexpr double kSupportShare = 0.8;  // of an edge's length that both planes must have points at

struct SurfacePlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset = 0.0;  // normal . x = offset
  double Distance(const Eigen::Vector3d& p) const { return std::abs(normal.dot(p) - offset); }
};

// Points by cells of one size.
class Grid {
 public:
  Grid(const std::vector<Eigen::Vector3d>& points, double cell) : points_(points), cell_(cell) {}
  void Add(int i) { cells_[KeyOf(points_[i])].push_back(i); }

  // Calls visit(i) for points in the cells within one of p's.
  template <typename Visit>
  void Near(const Eigen::Vector3d& p, const Visit& visit) const {
    const Eigen::Vector3d at = p / cell_;
    for (int n = 0; n < 27; ++n) {
      const auto it = cells_.find(Pack(static_cast<int64_t>(std::floor(at.x())) + n % 3 - 1,
                                       static_cast<int64_t>(std::floor(at.y())) + n / 3 % 3 - 1,
                                       static_cast<int64_t>(std::floor(at.z())) + n / 9 - 1));
      if (it == cells_.end()) continue;
      for (const int i : it->second) visit(i);
    }
  }
  bool Empty(const Eigen::Vector3d& p) const { return !cells_.contains(KeyOf(p)); }

 private:
  static uint64_t Pack(int64_t x, int64_t y, int64_t z) {
    return (static_cast<uint64_t>(x) & 0x1fffff) | ((static_cast<uint64_t>(y) & 0x1fffff) << 21) |
           ((static_cast<uint64_t>(z) & 0x1fffff) << 42);
  }
  uint64_t KeyOf(const Eigen::Vector3d& p) const {
    return Pack(static_cast<int64_t>(std::floor(p.x() / cell_)),
                static_cast<int64_t>(std::floor(p.y() / cell_)),
                static_cast<int64_t>(std::floor(p.z() / cell_)));
  }
  const std::vector<Eigen::Vector3d>& points_;
  double cell_;
  std::unordered_map<uint64_t, std::vector<int>> cells_;
};

// Plane of least squares; `thickness` is the root mean square distance from it.
SurfacePlane FitPlane(const std::vector<Eigen::Vector3d>& points,
                      const std::vector<int>& chosen,
                      double* thickness) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int i : chosen) mean += points[i];
  mean /= static_cast<double>(chosen.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int i : chosen) scatter += (points[i] - mean) * (points[i] - mean).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  *thickness =
      std::sqrt(std::max(0.0, eigen.eigenvalues()(0)) / static_cast<double>(chosen.size()));
  const Eigen::Vector3d normal = eigen.eigenvectors().col(0);
  return {normal, normal.dot(mean)};
}

class PointModel {
 public:
  PointModel(std::vector<Eigen::Vector3d> points, double spacing, const RangeImageOptions& options)
      : points_(std::move(points)), spacing_(spacing), options_(options) {
    EstimateNormals();
    FindPlanes();
  }

  const std::vector<SurfacePlane>& planes() const { return planes_; }
  double explained() const {
    size_t on = 0;
    for (const Eigen::Vector3d& p : points_) {
      on += std::any_of(planes_.begin(), planes_.end(), [&](const SurfacePlane& plane) {
        return plane.Distance(p) <= tolerance_;
      });
    }
    return static_cast<double>(on) / static_cast<double>(points_.size());
  }

  Wireframe Edges() {
    // A plane's own points, and those of its plane that lie beside them: the ones at its edges,
    // which have no normal. Where it runs on through other faces it also meets theirs.
    const double reach = kSupportReach * spacing_;
    std::vector<Grid> own(planes_.size(), Grid(points_, reach));
    for (int i = 0; i < static_cast<int>(points_.size()); ++i) {
      if (owner_[i] >= 0) own[static_cast<size_t>(owner_[i])].Add(i);
    }
    const auto within = [&](const Grid& grid, const Eigen::Vector3d& at) {
      bool found = false;
      grid.Near(at,
                [&](int i) { found = found || (points_[i] - at).squaredNorm() <= reach * reach; });
      return found;
    };
    std::vector<Grid> grids = own;
    for (int i = 0; i < static_cast<int>(points_.size()); ++i) {
      for (size_t p = 0; p < planes_.size(); ++p) {
        if (owner_[i] != static_cast<int>(p) && planes_[p].Distance(points_[i]) <= tolerance_ &&
            within(own[p], points_[i])) {
          grids[p].Add(i);
        }
      }
    }
    const auto supported = [&](int plane, const Eigen::Vector3d& at) {
      return within(grids[static_cast<size_t>(plane)], at);
    };
    FindCorners(supported);
    return JoinCorners(supported);
  }

 private:
  struct Corner {
    Eigen::Vector3d point;
    std::set<int> planes;
    int count = 1;
  };

  void EstimateNormals() {
    const double reach = kNormalReach * spacing_;
    Grid grid(points_, reach);
    for (int i = 0; i < static_cast<int>(points_.size()); ++i) grid.Add(i);
    normals_.assign(points_.size(), Eigen::Vector3d::Zero());
    std::vector<double> thickness(points_.size(), INFINITY), known;
    for (size_t i = 0; i < points_.size(); ++i) {
      std::vector<int> near;
      grid.Near(points_[i], [&](int k) {
        if ((points_[k] - points_[i]).squaredNorm() <= reach * reach) near.push_back(k);
      });
      if (near.size() < 6) continue;
      normals_[i] = FitPlane(points_, near, &thickness[i]).normal;
      known.push_back(thickness[i]);
    }
    // Most neighbourhoods lie in one face: their median thickness is the noise.
    double noise = 0.0;
    if (!known.empty()) {
      const auto middle = known.begin() + static_cast<long>(known.size() / 2);
      std::nth_element(known.begin(), middle, known.end());
      noise = *middle;
    }
    tolerance_ = std::clamp(4.0 * noise, 0.02 * spacing_, 0.5 * spacing_);
    // A thick neighbourhood lies about an edge: its normal belongs to neither face.
    for (size_t i = 0; i < points_.size(); ++i) {
      if (thickness[i] > std::max(2.0 * noise, 0.02 * spacing_)) normals_[i].setZero();
    }
  }

  std::vector<int> Members(const SurfacePlane& plane) const {
    std::vector<int> members;
    for (int i = 0; i < static_cast<int>(points_.size()); ++i) {
      if (owner_[i] < 0 && plane.Distance(points_[i]) <= tolerance_ &&
          std::abs(plane.normal.dot(normals_[i])) >= kNormalCos) {
        members.push_back(i);
      }
    }
    return members;
  }

  // The plane with most points first; what it explains is taken away.
  void FindPlanes() {
    owner_.assign(points_.size(), -1);
    std::mt19937 rng(options_.seed);
    const size_t least = std::max<size_t>(
        20, static_cast<size_t>(options_.min_plane_share * static_cast<double>(points_.size())));
    while (planes_.size() < kMaxPlanes) {
      std::vector<int> free;
      for (int i = 0; i < static_cast<int>(points_.size()); ++i) {
        if (owner_[i] < 0 && !normals_[i].isZero()) free.push_back(i);
      }
      if (free.size() < least) return;
      SurfacePlane best;
      std::vector<int> members;
      for (int s = 0; s < kSeeds; ++s) {
        const int seed = free[rng() % free.size()];
        const SurfacePlane plane{normals_[seed], normals_[seed].dot(points_[seed])};
        std::vector<int> found = Members(plane);
        if (found.size() > members.size()) best = plane, members = std::move(found);
      }
      for (int round = 0; round < 4 && members.size() >= least; ++round) {
        double thickness = 0.0;
        best = FitPlane(points_, members, &thickness);
        members = Members(best);
      }
      if (members.size() < least) return;
      for (const int i : members) owner_[i] = static_cast<int>(planes_.size());
      planes_.push_back(best);
    }
  }

  template <typename Supported>
  void FindCorners(const Supported& supported) {
    const int n = static_cast<int>(planes_.size());
    for (int a = 0; a < n; ++a) {
      for (int b = a + 1; b < n; ++b) {
        for (int c = b + 1; c < n; ++c) {
          Eigen::Matrix3d m;
          m << planes_[a].normal.transpose(), planes_[b].normal.transpose(),
              planes_[c].normal.transpose();
          if (!(std::abs(m.determinant()) > kMinDeterminant)) continue;
          const Eigen::Vector3d x =
              m.inverse() *
              Eigen::Vector3d(planes_[a].offset, planes_[b].offset, planes_[c].offset);
          if (!supported(a, x) || !supported(b, x) || !supported(c, x)) continue;
          const auto same = std::find_if(corners_.begin(), corners_.end(), [&](const Corner& k) {
            return (k.point - x).norm() <= 0.75 * spacing_;
          });
          if (same == corners_.end()) {
            corners_.push_back({x, {a, b, c}});
          } else {
            same->point += (x - same->point) / ++same->count;
            same->planes.insert({a, b, c});
          }
        }
      }
    }
  }

  template <typename Supported>
  Wireframe JoinCorners(const Supported& supported) const {
    std::set<std::pair<int, int>> edges;
    const int n = static_cast<int>(planes_.size());
    for (int a = 0; a < n; ++a) {
      for (int b = a + 1; b < n; ++b) {
        const Eigen::Vector3d along = planes_[a].normal.cross(planes_[b].normal);
        if (along.norm() < kMinPairSine) continue;
        std::vector<std::pair<double, int>> on_line;
        for (int k = 0; k < static_cast<int>(corners_.size()); ++k) {
          const std::set<int>& planes = corners_[k].planes;
          if (planes.contains(a) && planes.contains(b)) {
            on_line.push_back({along.dot(corners_[k].point), k});
          }
        }
        std::sort(on_line.begin(), on_line.end());
        for (size_t k = 1; k < on_line.size(); ++k) {
          const int from = on_line[k - 1].second, to = on_line[k].second;
          if (Covered(corners_[from].point, corners_[to].point, a, b, supported)) {
            edges.insert(std::minmax(from, to));
          }
        }
      }
    }
    Wireframe wireframe;
    for (const Corner& corner : corners_) wireframe.points.push_back(corner.point);
    wireframe.edges.assign(edges.begin(), edges.end());
    return wireframe;
  }

  template <typename Supported>
  bool Covered(const Eigen::Vector3d& from,
               const Eigen::Vector3d& to,
               int a,
               int b,
               const Supported& supported) const {
    const int steps = std::max(3, static_cast<int>(std::ceil((to - from).norm() / spacing_)));
    int both = 0;
    for (int s = 0; s < steps; ++s) {
      const Eigen::Vector3d at = from + (to - from) * ((s + 0.5) / steps);
      both += supported(a, at) && supported(b, at);
    }
    return both >= kSupportShare * steps;
  }

  const std::vector<Eigen::Vector3d> points_;
  const double spacing_;
  const RangeImageOptions options_;
  double tolerance_ = 0.0;  // distance of a plane's points from it
  std::vector<Eigen::Vector3d> normals_;
  std::vector<int> owner_;  // plane, or -1
  std::vector<SurfacePlane> planes_;
  std::vector<Corner> corners_;
};

// Median distance of a point from its `rank`-th neighbour, of a sample.
double MedianNeighborDistance(const std::vector<Eigen::Vector3d>& points, size_t rank) {
  constexpr size_t kSample = 200;
  const size_t step = std::max<size_t>(1, points.size() / kSample);
  std::vector<double> found, squared(points.size());
  for (size_t s = 0; s < points.size(); s += step) {
    for (size_t i = 0; i < points.size(); ++i) squared[i] = (points[i] - points[s]).squaredNorm();
    const auto at = squared.begin() + static_cast<long>(std::min(rank, squared.size() - 1));
    std::nth_element(squared.begin(), at, squared.end());
    found.push_back(std::sqrt(*at));
  }
  const auto middle = found.begin() + static_cast<long>(found.size() / 2);
  std::nth_element(found.begin(), middle, found.end());
  return *middle;
}

// One point per cell: dense scans cost no more than sparse ones.
std::vector<Eigen::Vector3d> Thinned(const std::vector<Eigen::Vector3d>& points, double cell) {
  std::vector<Eigen::Vector3d> kept;
  Grid grid(points, cell);
  for (int i = 0; i < static_cast<int>(points.size()); ++i) {
    if (!grid.Empty(points[i])) continue;
    grid.Add(i);
    kept.push_back(points[i]);
  }
  return kept;
}

}  // namespace

absl::StatusOr<RangeImageModel> ModelFromPoints(const std::vector<Eigen::Vector3d>& points,
                                                const RangeImageOptions& options) {
  if (points.size() < kMinPoints) {
    return absl::InvalidArgumentError(
        absl::StrCat(points.size(), " points, need ", kMinPoints, " to find planes"));
  }
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : points) box.extend(p);
  const double extent = box.diagonal().norm();
  if (!(extent > 0.0) || !std::isfinite(extent)) {
    return absl::InvalidArgumentError("the points have no extent");
  }
  // In the box's frame, so that cells have small numbers.
  std::vector<Eigen::Vector3d> moved;
  for (const Eigen::Vector3d& p : points) moved.push_back(p - box.min());
  double spacing = options.spacing_share * extent;
  std::vector<Eigen::Vector3d> thinned = Thinned(moved, 0.5 * spacing);
  // Within reach of a normal there must be more than the six points it needs.
  constexpr size_t kNeighbors = 12;
  spacing = std::max(spacing, MedianNeighborDistance(thinned, kNeighbors) / kNormalReach);
  PointModel model(std::move(thinned), spacing, options);
  RangeImageModel result;
  result.planes = static_cast<int>(model.planes().size());
  result.explained = model.explained();
  if (result.planes < 4) {
    return absl::InvalidArgumentError(
        absl::StrCat(result.planes, " planes in the points, need 4 for a part with corners"));
  }
  result.wireframe = model.Edges();
  if (result.wireframe.edges.size() < 6) {
    return absl::InvalidArgumentError(absl::StrCat(result.wireframe.edges.size(),
                                                   " edges between ",
                                                   result.planes,
                                                   " planes, need 6; do the points cover the part "
                                                   "all round?"));
  }
  for (Eigen::Vector3d& p : result.wireframe.points) p += box.min();
  return result;
}

}  // namespace horopter
