// How a range query goes through the tree; internal to server/index.
#pragma once

#include <cstddef>
#include <vector>

#include "server/index/node.h"
#include "server/index/x_tree.h"

namespace horopter::index_internal {

// One number per entry of a node; only supernodes need memory of their own.
class Scratch {
 public:
  double* For(const Node& node) {
    if (node.stride <= kInline) return inline_;
    if (values_.size() < static_cast<size_t>(node.stride)) values_.resize(node.stride);
    return values_.data();
  }

 private:
  static constexpr int kInline = 128;
  alignas(64) double inline_[kInline];
  std::vector<double> values_;
};

// Subtrees still to be visited; small queries allocate nothing.
class NodeStack {
 public:
  void Push(const Node* node) {
    // The header and the first rows, which are all that most visits read.
    for (int line = 0; line < kLinesAhead; ++line) {
      __builtin_prefetch(reinterpret_cast<const char*>(node) + 64 * line);
    }
    if (size_ < kInline) {
      inline_[size_++] = node;
    } else {
      overflow_.push_back(node);
    }
  }
  const Node* Pop() {
    if (overflow_.empty()) return size_ == 0 ? nullptr : inline_[--size_];
    const Node* node = overflow_.back();
    overflow_.pop_back();
    return node;
  }

 private:
  static constexpr int kInline = 256;
  static constexpr int kLinesAhead = 8;
  const Node* inline_[kInline];
  int size_ = 0;
  std::vector<const Node*> overflow_;
};

inline void Count(const Node& node, QueryStats& stats) {
  (node.leaf() ? stats.leaf_accesses : stats.directory_accesses) += node.blocks;
  stats.entries_tested += node.count;
}

// Directory nodes looked at before a query may decide that pruning does not pay.
inline constexpr int64_t kNodesBeforeScan = 8;

// Walks down wherever `enter(node, scratch, visit)` calls visit(child number), and hands leaves to
// `leaf(node, scratch)`. When more than scan_share of all children tested so far were entered, the
// rest is read without testing their bounds: a linear scan in storage order. Its overhead over one
// that knew from the start is the few directory nodes tested.
template <typename Enter, typename Leaf>
void Walk(const Node& root, double scan_share, QueryStats& stats, Enter enter, Leaf leaf) {
  NodeStack stack;
  stack.Push(&root);
  Scratch scratch;
  int64_t tested = 0, hit = 0, nodes = 0;
  bool scan = false;
  while (const Node* at = stack.Pop()) {
    const Node& node = *at;
    Count(node, stats);
    if (node.leaf()) {
      leaf(node, scratch);
      continue;
    }
    if (scan) {
      for (int i = node.count; i-- > 0;) stack.Push(node.children[i].get());
      continue;
    }
    enter(node, scratch, [&](int i) {
      stack.Push(node.children[i].get());
      ++hit;
    });
    tested += node.count;
    if (++nodes == kNodesBeforeScan &&
        static_cast<double>(hit) > scan_share * static_cast<double>(tested)) {
      scan = true;
      ++stats.scans;
    }
  }
}

}  // namespace horopter::index_internal
