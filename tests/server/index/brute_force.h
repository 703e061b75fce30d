// The linear scan that the X-tree must agree with.
#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "server/index/x_tree.h"

namespace horopter {

struct BruteForce {
  struct Item {
    std::vector<double> low;
    std::vector<double> high;
    int64_t id = 0;
  };
  std::vector<Item> items;

  std::vector<int64_t> Box(const std::vector<double>& low, const std::vector<double>& high) const {
    std::vector<int64_t> ids;
    for (const Item& item : items) {
      bool meets = true;
      for (size_t d = 0; d < low.size(); ++d) {
        meets &= item.low[d] <= high[d] && item.high[d] >= low[d];
      }
      if (meets) ids.push_back(item.id);
    }
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  static double SquaredDistance(const Item& item, const std::vector<double>& center) {
    double sum = 0.0;
    for (size_t d = 0; d < center.size(); ++d) {
      const double t = std::max({item.low[d] - center[d], center[d] - item.high[d], 0.0});
      sum += t * t;
    }
    return sum;
  }

  std::vector<int64_t> Radius(const std::vector<double>& center, double radius) const {
    std::vector<int64_t> ids;
    for (const Item& item : items) {
      if (SquaredDistance(item, center) <= radius * radius) ids.push_back(item.id);
    }
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  std::vector<Neighbor> Nearest(const std::vector<double>& center, int k) const {
    std::vector<std::pair<double, int64_t>> all;
    for (const Item& item : items) all.emplace_back(SquaredDistance(item, center), item.id);
    const size_t kept = std::min<size_t>(k, all.size());
    std::partial_sort(all.begin(), all.begin() + static_cast<ptrdiff_t>(kept), all.end());
    std::vector<Neighbor> found;
    for (size_t i = 0; i < kept; ++i) found.push_back({all[i].second, std::sqrt(all[i].first)});
    return found;
  }

  // Ids well inside, and ids so close to the surface that rounding decides.
  struct InsideIds {
    std::vector<int64_t> surely;
    std::vector<int64_t> perhaps;
  };
  InsideIds Inside(const Ellipsoid& e) const {
    InsideIds ids;
    const Eigen::LLT<Eigen::MatrixXd> factor(e.covariance);
    for (const Item& item : items) {
      Eigen::VectorXd x(e.center.size());
      for (Eigen::Index d = 0; d < x.size(); ++d) x(d) = 0.5 * (item.low[d] + item.high[d]);
      const double m = (x - e.center).dot(factor.solve(x - e.center));
      if (m < e.gate * (1 - 1e-9)) ids.surely.push_back(item.id);
      if (m < e.gate * (1 + 1e-9)) ids.perhaps.push_back(item.id);
    }
    std::sort(ids.surely.begin(), ids.surely.end());
    std::sort(ids.perhaps.begin(), ids.perhaps.end());
    return ids;
  }
};

inline std::vector<int64_t> Sorted(std::vector<int64_t> ids) {
  std::sort(ids.begin(), ids.end());
  return ids;
}

template <typename Match>
std::vector<int64_t> SortedIds(const std::vector<Match>& matches) {
  std::vector<int64_t> ids;
  for (const Match& match : matches) ids.push_back(match.id);
  return Sorted(std::move(ids));
}

// Well-conditioned to needle-like, of about the given size in each direction.
inline Ellipsoid RandomEllipsoid(const std::vector<double>& center,
                                 double size,
                                 std::mt19937& rng) {
  std::normal_distribution<double> normal;
  const Eigen::Index n = static_cast<Eigen::Index>(center.size());
  Eigen::MatrixXd a(n, n);
  for (Eigen::Index i = 0; i < a.size(); ++i) a.data()[i] = normal(rng) * size;
  Ellipsoid e;
  e.center = Eigen::Map<const Eigen::VectorXd>(center.data(), n);
  e.covariance = a * a.transpose() + 1e-4 * size * size * Eigen::MatrixXd::Identity(n, n);
  e.gate = 3.0;
  return e;
}

}  // namespace horopter
