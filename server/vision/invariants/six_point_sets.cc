#include "server/vision/invariants/six_point_sets.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

namespace horopter {
namespace {

constexpr int kTablePoints = 64;    // up to here the determinants of all fours are tabulated
constexpr double kCoplanar = 1e-9;  // smallest over largest second moment of points in a plane

std::int64_t Choose(std::int64_t n, int k) {
  std::int64_t out = 1;
  for (int i = 1; i <= k; ++i) {
    out = out * (n - k + i) / i;
    if (out > (std::int64_t{1} << 40)) return out;
  }
  return n < k ? 0 : out;
}

// Coordinates in which the second moment is the identity; empty when there are none.
std::vector<Eigen::Vector3d> Whitened(std::span<const Eigen::Vector3d> points) {
  const auto n = static_cast<double>(points.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& x : points) mean += x / n;
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  for (const auto& x : points) moment += (x - mean) * (x - mean).transpose() / n;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moment);
  const Eigen::Vector3d values = eigen.eigenvalues();
  if (!values.allFinite() || !(values(0) > kCoplanar * values(2))) return {};
  const Eigen::Matrix3d W =
      values.cwiseSqrt().cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose();
  std::vector<Eigen::Vector3d> out;
  for (const auto& x : points) out.push_back(W * (x - mean));
  return out;
}

double Determinant(const std::vector<Eigen::Vector3d>& p, int a, int b, int c, int d) {
  return std::abs((p[b] - p[a]).dot((p[c] - p[a]).cross(p[d] - p[a])));
}

// |det| of every four points a < b < c < d, at C(a, 1) + C(b, 2) + C(c, 3) + C(d, 4).
class Determinants {
 public:
  explicit Determinants(const std::vector<Eigen::Vector3d>& points) : points_(points) {
    const int n = static_cast<int>(points.size());
    if (n > kTablePoints) return;
    table_.resize(static_cast<std::size_t>(Choose(n, 4)));
    for (int d = 0; d < n; ++d) {
      for (int c = 0; c < d; ++c) {
        for (int b = 0; b < c; ++b) {
          for (int a = 0; a < b; ++a) {
            table_[At(a, b, c, d)] = static_cast<float>(Determinant(points, a, b, c, d));
          }
        }
      }
    }
  }

  // The smallest of a set's fifteen.
  float Smallest(const std::array<int, 6>& t) const {
    float smallest = INFINITY;
    for (int i = 0; i < 6; ++i) {
      for (int j = i + 1; j < 6; ++j) {
        std::array<int, 4> four;
        for (int k = 0, m = 0; k < 6; ++k) {
          if (k != i && k != j) four[m++] = t[k];
        }
        const auto [a, b, c, d] = four;
        smallest = std::min(smallest,
                            table_.empty() ? static_cast<float>(Determinant(points_, a, b, c, d))
                                           : table_[At(a, b, c, d)]);
      }
    }
    return smallest;
  }

 private:
  static std::size_t At(int a, int b, int c, int d) {
    return static_cast<std::size_t>(a + b * (b - 1) / 2 + c * (c - 1) * (c - 2) / 6 +
                                    d * (d - 1) * (d - 2) * (d - 3) / 24);
  }
  const std::vector<Eigen::Vector3d>& points_;
  std::vector<float> table_;
};

std::vector<std::array<int, 6>> AllSets(int n) {
  std::vector<std::array<int, 6>> sets;
  std::array<int, 6> t{0, 1, 2, 3, 4, 5};
  while (true) {
    sets.push_back(t);
    int k = 5;
    while (k >= 0 && t[k] == n - 6 + k) --k;
    if (k < 0) return sets;
    ++t[k];
    for (int j = k + 1; j < 6; ++j) t[j] = t[j - 1] + 1;
  }
}

std::vector<std::array<int, 6>> DrawnSets(int n, int draws, unsigned seed) {
  std::vector<std::array<int, 6>> sets;
  std::mt19937 rng(seed);
  std::array<int, 6> t{};
  for (int draw = 0; draw < draws; ++draw) {
    for (int k = 0; k < 6; ++k) {
      do {
        t[k] = static_cast<int>(rng() % static_cast<unsigned>(n));
      } while (std::find(t.begin(), t.begin() + k, t[k]) != t.begin() + k);
    }
    std::sort(t.begin(), t.end());
    sets.push_back(t);
  }
  std::sort(sets.begin(), sets.end());
  sets.erase(std::unique(sets.begin(), sets.end()), sets.end());
  return sets;
}

}  // namespace

std::vector<std::array<int, 6>> WellSpreadSets(std::span<const Eigen::Vector3d> points,
                                               int most,
                                               const SixPointSetOptions& options) {
  const int n = static_cast<int>(points.size());
  if (n < 6 || most <= 0) return {};
  const std::vector<Eigen::Vector3d> whitened = Whitened(points);
  if (whitened.empty()) return {};
  const std::vector<std::array<int, 6>> sets =
      Choose(n, 6) <= options.max_looked_at ? AllSets(n)
                                            : DrawnSets(n, options.max_looked_at, options.seed);
  const Determinants determinants(whitened);
  std::vector<std::pair<float, int>> order;  // the sets are in the order of their indices
  for (std::size_t i = 0; i < sets.size(); ++i) {
    const float smallest = determinants.Smallest(sets[i]);
    if (smallest > 0.0f) order.push_back({-smallest, static_cast<int>(i)});
  }
  const std::size_t kept = std::min(order.size(), static_cast<std::size_t>(most));
  std::partial_sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(kept), order.end());
  std::vector<std::array<int, 6>> out;
  for (std::size_t i = 0; i < kept; ++i) out.push_back(sets[order[i].second]);
  return out;
}

}  // namespace horopter
