#include <algorithm>
#include <iterator>
#include <limits>
#include <numeric>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/index/node.h"
#include "server/index/x_tree.h"

namespace horopter {

using index_internal::Entry;
using index_internal::Node;

namespace {

// Nodes are packed to this share, so that the first inserts do not split every one of them.
constexpr double kBulkFill = 0.95;
// Rows of a subtree that are copied together before it is divided further: about what the second
// cache of a core holds.
constexpr size_t kLocalBytes = size_t{1} << 19;
// Fewer objects are not worth a thread.
constexpr size_t kObjectsPerThread = 50000;

using MakeNode = std::function<std::shared_ptr<Node>(int level)>;

// Top-down packing: the objects are halved along the widest dimension, at a multiple of what a
// subtree holds, until a piece fits into one. Pieces of points do not overlap, and the dimensions
// cut become the split history. The result does not depend on the number of threads.
template <typename Scalar>
class Packer {
 public:
  Packer(const Scalar* lows,
         const Scalar* highs,
         const int64_t* ids,
         size_t count,
         const XTreeOptions& options,
         const MakeNode& new_node)
      : lows_(lows),
        highs_(highs),
        ids_(ids),
        options_(options),
        new_node_(new_node),
        order_(count),
        sorted_(count) {
    std::iota(order_.begin(), order_.end(), 0u);
  }

  std::shared_ptr<Node> BuildAll(int threads) {
    int level = 0;
    while (SubtreeCapacity(level) < order_.size()) ++level;
    return Build(0, order_.size(), level, threads);
  }

 private:
  struct Place {
    Scalar middle;  // twice; rounding it only moves the cut
    uint32_t object;
    bool operator<(const Place& other) const {
      return middle != other.middle ? middle < other.middle : object < other.object;
    }
  };

  // A copy of [begin, end) of another packer's objects, side by side in memory.
  Packer(const Packer& from, size_t begin, size_t end)
      : Packer(nullptr, nullptr, nullptr, end - begin, from.options_, from.new_node_) {
    const bool points = from.lows_ == from.highs_;
    const size_t n = dims();
    own_lows_.reserve(n * (end - begin));
    own_highs_.reserve(points ? 0 : n * (end - begin));
    own_ids_.reserve(end - begin);
    for (size_t i = begin; i < end; ++i) {
      const size_t object = from.order_[i], at = object * n;
      own_lows_.insert(own_lows_.end(), from.lows_ + at, from.lows_ + at + n);
      if (!points) own_highs_.insert(own_highs_.end(), from.highs_ + at, from.highs_ + at + n);
      own_ids_.push_back(from.ids_[object]);
    }
    lows_ = own_lows_.data();
    highs_ = points ? lows_ : own_highs_.data();
    ids_ = own_ids_.data();
    local_ = true;
  }

  size_t dims() const { return static_cast<size_t>(options_.dimensions); }
  Scalar Middle(uint32_t i, size_t d) const {
    return lows_[i * dims() + d] + highs_[i * dims() + d];
  }

  // Of many objects as of a sample of them: which dimension is cut matters little there.
  size_t WidestDimension(size_t begin, size_t end) const {
    constexpr size_t kSample = 8192;
    const size_t step = std::max<size_t>(1, (end - begin) / kSample);
    Scalar least[kMaxDimensions], most[kMaxDimensions];
    std::fill_n(least, dims(), std::numeric_limits<Scalar>::infinity());
    std::fill_n(most, dims(), -std::numeric_limits<Scalar>::infinity());
    for (size_t i = begin; i < end; i += step) {
      for (size_t d = 0; d < dims(); ++d) {
        const Scalar middle = Middle(order_[i], d);
        least[d] = std::min(least[d], middle);
        most[d] = std::max(most[d], middle);
      }
    }
    size_t widest = 0;
    for (size_t d = 1; d < dims(); ++d) {
      if (most[d] - least[d] > most[widest] - least[widest]) widest = d;
    }
    return widest;
  }

  // Reorders [begin, end) so that the objects before `middle` lie before the others along d. The
  // coordinates are gathered first: sorting through the order would miss the cache at every look.
  void Halve(size_t begin, size_t middle, size_t end, size_t d) {
    for (size_t i = begin; i < end; ++i) sorted_[i] = {Middle(order_[i], d), order_[i]};
    const auto at = [&](size_t i) { return sorted_.begin() + static_cast<ptrdiff_t>(i); };
    std::nth_element(at(begin), at(middle), at(end));
    for (size_t i = begin; i < end; ++i) order_[i] = sorted_[i].object;
  }

  // Divides [begin, end) into `pieces` subtrees of the level and appends them to `out`.
  void Divide(size_t begin,
              size_t end,
              size_t pieces,
              int level,
              uint64_t history,
              int threads,
              std::vector<Entry>& out) {
    if (pieces == 1) {
      std::shared_ptr<Node> child = Build(begin, end, level, threads);
      Entry& entry = out.emplace_back(child->Bounds());
      entry.child = std::move(child);
      entry.history = history;
      return;
    }
    const size_t row_bytes = 2 * dims() * sizeof(Scalar) + sizeof(int64_t);
    if (!local_ && (end - begin) * row_bytes <= kLocalBytes) {
      Packer(*this, begin, end).Divide(0, end - begin, pieces, level, history, 1, out);
      return;
    }
    const size_t left = pieces / 2;
    const size_t middle = begin + (end - begin) * left / pieces;
    const size_t d = WidestDimension(begin, end);
    Halve(begin, middle, end, d);
    history |= uint64_t{1} << d;
    if (threads < 2 || end - begin < kObjectsPerThread) {
      Divide(begin, middle, left, level, history, 1, out);
      Divide(middle, end, pieces - left, level, history, 1, out);
      return;
    }
    std::vector<Entry> second;  // both halves work on their own ranges
    ParallelFor(2, threads, [&](int half) {
      if (half == 0) {
        Divide(begin, middle, left, level, history, threads - threads / 2, out);
      } else {
        Divide(middle, end, pieces - left, level, history, threads / 2, second);
      }
    });
    std::move(second.begin(), second.end(), std::back_inserter(out));
  }

  std::shared_ptr<Node> Build(size_t begin, size_t end, int level, int threads) {
    std::shared_ptr<Node> node = new_node_(level);
    if (level == 0) {
      double low[kMaxDimensions], high[kMaxDimensions];
      for (size_t i = begin; i < end; ++i) {
        const size_t at = order_[i] * dims();
        std::copy_n(lows_ + at, dims(), low);
        std::copy_n(highs_ + at, dims(), high);
        node->AppendObject(low, high, ids_[order_[i]]);
      }
      return node;
    }
    const size_t capacity = SubtreeCapacity(level - 1);
    const size_t pieces = std::max<size_t>(1, (end - begin + capacity - 1) / capacity);
    std::vector<Entry> children;
    children.reserve(pieces);
    Divide(begin, end, pieces, level - 1, 0, threads, children);
    for (const Entry& child : children) node->Append(child);
    return node;
  }

  size_t SubtreeCapacity(int level) const {
    const auto packed = [](int capacity) {
      return std::max<size_t>(2, static_cast<size_t>(kBulkFill * capacity));
    };
    size_t capacity = packed(options_.leaf_capacity);
    for (int i = 0; i < level; ++i) capacity *= packed(options_.directory_capacity);
    return capacity;
  }

  const Scalar* lows_;
  const Scalar* highs_;  // of points the same
  const int64_t* ids_;
  const XTreeOptions& options_;
  const MakeNode& new_node_;
  std::vector<uint32_t> order_;
  std::vector<Place> sorted_;  // scratch
  bool local_ = false;
  std::vector<Scalar> own_lows_, own_highs_;
  std::vector<int64_t> own_ids_;
};

}  // namespace

template <typename Scalar>
absl::StatusOr<XTree> XTree::Packed(const XTreeOptions& options,
                                    std::span<const Scalar> lows,
                                    std::span<const Scalar> highs,
                                    std::span<const int64_t> ids,
                                    int threads) {
  HOROPTER_ASSIGN_OR_RETURN(XTree tree, Create(options));
  const size_t dimensions = options.dimensions;
  if (ids.size() > std::numeric_limits<uint32_t>::max()) {
    return absl::InvalidArgumentError("ids: more than 2^32");
  }
  if (lows.size() != ids.size() * dimensions || highs.size() != lows.size()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "points: ", lows.size(), " coordinates for ", ids.size(), " ids in R^", dimensions));
  }
  double low[kMaxDimensions], high[kMaxDimensions];
  for (size_t i = 0; i < ids.size(); ++i) {
    std::copy_n(lows.data() + i * dimensions, dimensions, low);
    std::copy_n(highs.data() + i * dimensions, dimensions, high);
    HOROPTER_RETURN_IF_ERROR(tree.CheckBox({low, dimensions}, {high, dimensions}));
  }
  if (ids.empty()) return tree;
  const MakeNode new_node = [&](int level) { return tree.NewNode(level); };
  Packer<Scalar> packer(lows.data(), highs.data(), ids.data(), ids.size(), options, new_node);
  tree.state_.root_ = packer.BuildAll(threads);
  tree.state_.size_ = static_cast<int64_t>(ids.size());
  return tree;
}

absl::StatusOr<XTree> XTree::BulkLoad(const XTreeOptions& options,
                                      std::span<const double> points,
                                      std::span<const int64_t> ids,
                                      int threads) {
  return Packed(options, points, points, ids, threads);
}

absl::StatusOr<XTree> XTree::BulkLoadBoxes(const XTreeOptions& options,
                                           std::span<const double> lows,
                                           std::span<const double> highs,
                                           std::span<const int64_t> ids,
                                           int threads) {
  return Packed(options, lows, highs, ids, threads);
}

absl::StatusOr<XTree> XTree::BulkLoadBoxes(const XTreeOptions& options,
                                           std::span<const float> lows,
                                           std::span<const float> highs,
                                           std::span<const int64_t> ids,
                                           int threads) {
  return Packed(options, lows, highs, ids, threads);
}

}  // namespace horopter
