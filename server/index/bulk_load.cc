#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/index/node.h"
#include "server/index/x_tree.h"

namespace horopter {

using index_internal::Entry;
using index_internal::Node;

namespace {

// Nodes are packed to this share, so that the first inserts do not split every one of them.
constexpr double kBulkFill = 0.95;

// Top-down packing: the objects are halved along the widest dimension, at a multiple of what a
// subtree holds, until a piece fits into one. Pieces of points do not overlap, and the dimensions
// cut become the split history.
struct Packer {
  const double* lows;
  const double* highs;
  const int64_t* ids;
  const XTreeOptions& options;
  std::function<std::shared_ptr<Node>(int level)> new_node;
  std::vector<uint32_t> order;

  size_t dims() const { return options.dimensions; }
  double Middle(uint32_t i, size_t d) const { return lows[i * dims() + d] + highs[i * dims() + d]; }

  // Of many objects as of a sample of them: which dimension is cut matters little there.
  int WidestDimension(size_t begin, size_t end) const {
    constexpr size_t kSample = 8192;
    const size_t step = std::max<size_t>(1, (end - begin) / kSample);
    int widest = 0;
    double width = -1.0;
    for (size_t d = 0; d < dims(); ++d) {
      double least = std::numeric_limits<double>::infinity(), most = -least;
      for (size_t i = begin; i < end; i += step) {
        least = std::min(least, Middle(order[i], d));
        most = std::max(most, Middle(order[i], d));
      }
      if (most - least > width) {
        width = most - least;
        widest = static_cast<int>(d);
      }
    }
    return widest;
  }

  // Divides [begin, end) into `pieces` subtrees of level node.level - 1 and appends them.
  void Divide(size_t begin, size_t end, size_t pieces, uint64_t history, Node& node) {
    if (pieces == 1) {
      std::shared_ptr<Node> child = Build(begin, end, node.level - 1);
      Entry entry = child->Bounds();
      entry.child = std::move(child);
      entry.history = history;
      node.Append(entry);
      return;
    }
    const size_t left = pieces / 2;
    const size_t middle = begin + (end - begin) * left / pieces;
    const size_t d = WidestDimension(begin, end);
    std::nth_element(order.begin() + static_cast<ptrdiff_t>(begin),
                     order.begin() + static_cast<ptrdiff_t>(middle),
                     order.begin() + static_cast<ptrdiff_t>(end),
                     [&](uint32_t a, uint32_t b) {
                       const double x = Middle(a, d), y = Middle(b, d);
                       return x != y ? x < y : a < b;
                     });
    history |= uint64_t{1} << d;
    Divide(begin, middle, left, history, node);
    Divide(middle, end, pieces - left, history, node);
  }

  std::shared_ptr<Node> Build(size_t begin, size_t end, int level) {
    std::shared_ptr<Node> node = new_node(level);
    if (level == 0) {
      for (size_t i = begin; i < end; ++i) {
        const size_t at = order[i] * dims();
        node->AppendObject(lows + at, highs + at, ids[order[i]]);
      }
      return node;
    }
    const size_t capacity = SubtreeCapacity(level - 1);
    Divide(begin, end, std::max<size_t>(1, (end - begin + capacity - 1) / capacity), 0, *node);
    return node;
  }

  size_t SubtreeCapacity(int level) const {
    const auto packed = [](int capacity) {
      return std::max<size_t>(2, static_cast<size_t>(kBulkFill * capacity));
    };
    size_t capacity = packed(options.leaf_capacity);
    for (int i = 0; i < level; ++i) capacity *= packed(options.directory_capacity);
    return capacity;
  }
};

}  // namespace

absl::StatusOr<XTree> XTree::BulkLoad(const XTreeOptions& options,
                                      std::span<const double> points,
                                      std::span<const int64_t> ids) {
  return BulkLoadBoxes(options, points, points, ids);
}

absl::StatusOr<XTree> XTree::BulkLoadBoxes(const XTreeOptions& options,
                                           std::span<const double> lows,
                                           std::span<const double> highs,
                                           std::span<const int64_t> ids) {
  HOROPTER_ASSIGN_OR_RETURN(XTree tree, Create(options));
  const size_t dimensions = options.dimensions;
  if (ids.size() > std::numeric_limits<uint32_t>::max()) {
    return absl::InvalidArgumentError("ids: more than 2^32");
  }
  if (lows.size() != ids.size() * dimensions || highs.size() != lows.size()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "points: ", lows.size(), " coordinates for ", ids.size(), " ids in R^", dimensions));
  }
  for (size_t i = 0; i < ids.size(); ++i) {
    HOROPTER_RETURN_IF_ERROR(tree.CheckBox(lows.subspan(i * dimensions, dimensions),
                                           highs.subspan(i * dimensions, dimensions)));
  }
  if (ids.empty()) return tree;
  Packer packer{lows.data(),
                highs.data(),
                ids.data(),
                options,
                [&](int level) { return tree.NewNode(level); },
                std::vector<uint32_t>(ids.size())};
  std::iota(packer.order.begin(), packer.order.end(), 0u);
  int level = 0;
  while (packer.SubtreeCapacity(level) < ids.size()) ++level;
  tree.state_.root_ = packer.Build(0, ids.size(), level);
  tree.state_.size_ = static_cast<int64_t>(ids.size());
  return tree;
}

}  // namespace horopter
