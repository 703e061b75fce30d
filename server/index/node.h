// Nodes of the X-tree and what moves between them; internal to server/index.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

namespace horopter::index_internal {

struct Node;

// One entry on its way into or out of a node: an object (level 0) or a subtree.
struct Entry {
  std::vector<double> low;
  std::vector<double> high;
  int64_t id = 0;
  std::shared_ptr<Node> child;  // set: a subtree
  uint64_t history = 0;         // bit d: the subtree's region was split along dimension d
};

// Bounds are stored dimension by dimension (low[d * stride + i]), so that a query tests one
// coordinate of many entries with one instruction. Leaves of points have no `high`.
struct Node {
  Node(int level, int dimensions, int capacity, bool boxes);

  int level = 0;  // 0: leaf
  int dimensions = 0;
  int count = 0;
  int capacity = 0;  // entries before it overflows; a supernode's is a multiple of a node's
  int blocks = 1;    // capacity in normal nodes
  int stride = 0;    // > capacity: room for the entry that makes it overflow
  uint64_t epoch = 0;
  std::vector<double> low;
  std::vector<double> high;
  std::vector<int64_t> ids;                     // leaves
  std::vector<std::shared_ptr<Node>> children;  // directory nodes
  std::vector<uint64_t> history;                // directory nodes, as in Entry

  bool leaf() const { return level == 0; }
  const double* Low(int d) const { return low.data() + static_cast<size_t>(d) * stride; }
  const double* High(int d) const {
    return (high.empty() ? low.data() : high.data()) + static_cast<size_t>(d) * stride;
  }

  void Append(const Entry& entry);
  void Set(int i, const Entry& entry);
  Entry Get(int i) const;
  void Remove(int i);  // the last entry takes its place
  void Clear();
  // Tight bounds of all entries; count > 0.
  Entry Bounds() const;
  // Copies the bounds of entry i's child from the child; true when they changed.
  bool TightenChild(int i);
  void Grow(int new_capacity, int new_blocks);
  int64_t Bytes() const;
};

bool SameBox(const Node& node, int i, const Entry& entry);

}  // namespace horopter::index_internal
