#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <utility>

#include "server/index/box_kernels.h"
#include "server/index/walk.h"

namespace horopter {

using index_internal::Node;
using index_internal::Scratch;
using index_internal::SquaredDistances;

namespace {

// Nearest neighbours depth first, nearest subtree first (Roussopoulos et al. 1995).
class NearestSearch {
 public:
  NearestSearch(std::span<const double> center, size_t k, QueryStats& stats)
      : center_(center), k_(k), stats_(stats) {
    best_.reserve(std::min<size_t>(k, 1024) + 1);
    pending_.reserve(128);
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
    if (!sorted_) std::sort_heap(best_.begin(), best_.end());
    std::vector<Neighbor> found;
    found.reserve(best_.size());
    for (const auto& [squared, id] : best_) found.push_back({id, std::sqrt(squared)});
    return found;
  }

 private:
  using Pending = std::pair<double, const Node*>;

  void Offer(double squared, int64_t id) {
    const std::pair<double, int64_t> entry(squared, id);
    const bool full = best_.size() == k_;
    if (sorted_) {  // few neighbours: moving them is cheaper than a heap
      if (full) {
        if (!(entry < best_.back())) return;
        best_.pop_back();
      }
      size_t at = best_.size();
      best_.push_back(entry);
      for (; at > 0 && entry < best_[at - 1]; --at) best_[at] = best_[at - 1];
      best_[at] = entry;
      if (best_.size() == k_) bound_ = best_.back().first;
      return;
    }
    if (full) {
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
  bool sorted_ = k_ <= 32;
  QueryStats& stats_;
  double bound_ = std::numeric_limits<double>::infinity();  // squared distance of the k-th so far
  std::vector<std::pair<double, int64_t>> best_;            // ascending, or max-heap
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

}  // namespace horopter
