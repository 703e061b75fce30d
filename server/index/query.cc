#include <Eigen/Cholesky>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/index/box_kernels.h"
#include "server/index/node.h"
#include "server/index/x_tree.h"

namespace horopter {

using index_internal::BoxExcess;
using index_internal::Node;
using index_internal::SquaredDistances;

namespace {

// One number per entry of a node; supernodes can be of any size.
class Scratch {
 public:
  double* For(const Node& node) {
    if (values_.size() < static_cast<size_t>(node.stride)) values_.resize(node.stride);
    return values_.data();
  }

 private:
  std::vector<double> values_ = std::vector<double>(128);
};

void Count(const Node& node, QueryStats& stats) {
  (node.leaf() ? stats.leaf_accesses : stats.directory_accesses) += node.blocks;
  stats.entries_tested += node.count;
}

// Directory nodes looked at before a query may decide that pruning does not pay.
constexpr int64_t kNodesBeforeScan = 8;

// Walks down wherever `filter(node, scratch)` leaves entries with a value <= limit(), and hands the
// leaves to `leaf`. When more than scan_share of all children tested so far were hit, the rest is
// read without testing their bounds: a linear scan in storage order. Its overhead over one that
// knew from the start is the few directory nodes tested.
template <typename Filter, typename Leaf>
void Walk(const Node& root, double scan_share, QueryStats& stats, Filter filter, Leaf leaf) {
  std::vector<const Node*> stack{&root};
  stack.reserve(256);
  Scratch scratch;
  int64_t tested = 0, hit = 0, nodes = 0;
  bool scan = false;
  while (!stack.empty()) {
    const Node& node = *stack.back();
    stack.pop_back();
    Count(node, stats);
    if (node.leaf()) {
      leaf(node, scratch.For(node));
      continue;
    }
    if (scan) {
      for (int i = node.count; i-- > 0;) stack.push_back(node.children[i].get());
      continue;
    }
    double* values = scratch.For(node);
    filter(node, values);
    const size_t before = stack.size();
    for (int i = node.count; i-- > 0;) {
      if (values[i] <= 0.0) stack.push_back(node.children[i].get());
    }
    ++nodes;
    tested += node.count;
    hit += static_cast<int64_t>(stack.size() - before);
    if (nodes == kNodesBeforeScan &&
        static_cast<double>(hit) > scan_share * static_cast<double>(tested)) {
      scan = true;
      ++stats.scans;
    }
  }
}

}  // namespace

std::vector<int64_t> XTreeSnapshot::Box(std::span<const double> low,
                                        std::span<const double> high,
                                        QueryStats* stats) const {
  assert(low.size() == static_cast<size_t>(dimensions()) && high.size() == low.size());
  std::vector<int64_t> ids;
  if (root_ == nullptr) return ids;
  QueryStats unused;
  const auto excess = [&](const Node& node, double* values) {
    BoxExcess(node, low.data(), high.data(), values);
  };
  Walk(*root_,
       options_.scan_share,
       stats != nullptr ? *stats : unused,
       excess,
       [&](const Node& node, double* values) {
         excess(node, values);
         for (int i = 0; i < node.count; ++i) {
           if (values[i] <= 0.0) ids.push_back(node.ids[i]);
         }
       });
  return ids;
}

std::vector<Neighbor> XTreeSnapshot::Radius(std::span<const double> center,
                                            double radius,
                                            QueryStats* stats) const {
  assert(center.size() == static_cast<size_t>(dimensions()));
  std::vector<Neighbor> found;
  if (root_ == nullptr || !(radius >= 0.0)) return found;
  QueryStats unused;
  const double bound = radius * radius;
  Walk(
      *root_,
      options_.scan_share,
      stats != nullptr ? *stats : unused,
      [&](const Node& node, double* values) {
        SquaredDistances(node, center.data(), bound, values);
        for (int i = 0; i < node.count; ++i) values[i] -= bound;
      },
      [&](const Node& node, double* values) {
        if (!SquaredDistances(node, center.data(), bound, values)) return;
        for (int i = 0; i < node.count; ++i) {
          if (values[i] <= bound) found.push_back({node.ids[i], std::sqrt(values[i])});
        }
      });
  return found;
}

namespace {

// Nearest neighbours depth first, nearest subtree first (Roussopoulos et al. 1995).
class NearestSearch {
 public:
  NearestSearch(std::span<const double> center, size_t k, QueryStats& stats)
      : center_(center), k_(k), stats_(stats) {
    best_.reserve(std::min<size_t>(k, 1024) + 1);
  }

  void Visit(const Node& node) {
    Count(node, stats_);
    double* squared = scratch_.For(node);
    if (!SquaredDistances(node, center_.data(), bound_, squared)) return;
    if (node.leaf()) {
      for (int i = 0; i < node.count; ++i) {
        if (squared[i] <= bound_) Offer(squared[i], node.ids[i]);
      }
      return;
    }
    const size_t begin = pending_.size();
    for (int i = 0; i < node.count; ++i) {
      if (squared[i] <= bound_) pending_.emplace_back(squared[i], node.children[i].get());
    }
    const auto nearer_last = [](const Pending& a, const Pending& b) { return a.first > b.first; };
    std::make_heap(pending_.begin() + static_cast<ptrdiff_t>(begin), pending_.end(), nearer_last);
    while (pending_.size() > begin) {
      std::pop_heap(pending_.begin() + static_cast<ptrdiff_t>(begin), pending_.end(), nearer_last);
      const Pending next = pending_.back();
      pending_.pop_back();
      if (next.first > bound_) break;
      Visit(*next.second);
    }
    pending_.resize(begin);
  }

  std::vector<Neighbor> Take() {
    std::sort_heap(best_.begin(), best_.end());
    std::vector<Neighbor> found;
    found.reserve(best_.size());
    for (const auto& [squared, id] : best_) found.push_back({id, std::sqrt(squared)});
    return found;
  }

 private:
  using Pending = std::pair<double, const Node*>;

  void Offer(double squared, int64_t id) {
    const std::pair<double, int64_t> entry(squared, id);
    if (best_.size() == k_) {
      if (!(entry < best_.front())) return;
      std::pop_heap(best_.begin(), best_.end());
      best_.back() = entry;
    } else {
      best_.push_back(entry);
    }
    std::push_heap(best_.begin(), best_.end());
    if (best_.size() == k_) bound_ = best_.front().first;
  }

  std::span<const double> center_;
  size_t k_;
  QueryStats& stats_;
  double bound_ = std::numeric_limits<double>::infinity();  // squared distance of the k-th so far
  std::vector<std::pair<double, int64_t>> best_;            // max-heap
  std::vector<Pending> pending_;                            // subtrees, level after level
  Scratch scratch_;
};

}  // namespace

std::vector<Neighbor> XTreeSnapshot::Nearest(std::span<const double> center,
                                             int k,
                                             QueryStats* stats) const {
  assert(center.size() == static_cast<size_t>(dimensions()));
  if (root_ == nullptr || k < 1 || root_->count == 0) return {};
  QueryStats unused;
  NearestSearch search(center, static_cast<size_t>(k), stats != nullptr ? *stats : unused);
  search.Visit(*root_);
  return search.Take();
}

absl::StatusOr<std::vector<EllipsoidMatch>> XTreeSnapshot::Inside(const Ellipsoid& ellipsoid,
                                                                  QueryStats* stats) const {
  const Eigen::Index n = dimensions();
  if (ellipsoid.center.size() != n || ellipsoid.covariance.rows() != n ||
      ellipsoid.covariance.cols() != n) {
    return absl::InvalidArgumentError(absl::StrCat("ellipsoid: not of dimension ", n));
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(ellipsoid.covariance);
  if (!ellipsoid.center.allFinite() || !ellipsoid.covariance.allFinite() ||
      factor.info() != Eigen::Success) {
    return absl::InvalidArgumentError("ellipsoid.covariance: not positive definite");
  }
  std::vector<EllipsoidMatch> found;
  const double gate = ellipsoid.gate;
  if (root_ == nullptr || !(gate >= 0.0)) return found;

  // y = L^-1 (x - c) makes the ellipsoid a ball; row-major for the loops below.
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const RowMajor whiten = factor.matrixL().solve(Eigen::MatrixXd::Identity(n, n));
  // A hair wider than exact: rounding must not lose what the exact test would accept.
  const Eigen::VectorXd half = (ellipsoid.covariance.diagonal() * gate).cwiseSqrt() * (1.0 + 1e-12);
  const Eigen::VectorXd low = ellipsoid.center - half, high = ellipsoid.center + half;
  const double* center = ellipsoid.center.data();

  // Lower bound of |y|^2 over child i's box, by interval arithmetic row by row.
  const auto misses = [&](const Node& node, int i) {
    double sum = 0.0;
    for (Eigen::Index r = 0; r < n; ++r) {
      double least = 0.0, most = 0.0;
      for (Eigen::Index c = 0; c <= r; ++c) {
        const double w = whiten(r, c);
        const double a = w * (node.Low(static_cast<int>(c))[i] - center[c]);
        const double b = w * (node.High(static_cast<int>(c))[i] - center[c]);
        least += std::min(a, b);
        most += std::max(a, b);
      }
      const double t = least > 0.0 ? least : most < 0.0 ? most : 0.0;
      sum += t * t;
      if (sum > gate * (1.0 + 1e-9)) return true;
    }
    return false;
  };
  QueryStats unused;
  Walk(
      *root_,
      options_.scan_share,
      stats != nullptr ? *stats : unused,
      [&](const Node& node, double* values) {
        BoxExcess(node, low.data(), high.data(), values);
        for (int i = 0; i < node.count; ++i) {
          if (values[i] <= 0.0 && misses(node, i)) values[i] = 1.0;
        }
      },
      [&](const Node& node, double* values) {
        // The bounding box of the ellipsoid thins the entries of points; a box is judged by its
        // centre, which lies in it.
        BoxExcess(node, low.data(), high.data(), values);
        for (int i = 0; i < node.count; ++i) {
          if (values[i] > 0.0) continue;
          double sum = 0.0;
          for (Eigen::Index r = 0; r < n && sum <= gate; ++r) {
            double y = 0.0;
            for (Eigen::Index c = 0; c <= r; ++c) {
              const int d = static_cast<int>(c);
              y += whiten(r, c) * (0.5 * (node.Low(d)[i] + node.High(d)[i]) - center[c]);
            }
            sum += y * y;
          }
          if (sum <= gate) found.push_back({node.ids[i], sum});
        }
      });
  return found;
}

}  // namespace horopter
