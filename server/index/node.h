// Nodes of the X-tree and what moves between them; internal to server/index.
#pragma once

#include <cstddef>
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

// Bounds are stored dimension by dimension, low row before high row, so that a query tests one
// coordinate of many entries with one instruction; leaves of points have no high rows. Header and
// rows are one block of memory: what a query reads of a node lies side by side.
struct Node {
  // Empty.
  static std::shared_ptr<Node> Make(int level, int dimensions, int capacity, bool boxes);
  static std::shared_ptr<Node> Copy(const Node& node);
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  int level = 0;  // 0: leaf
  int dimensions = 0;
  int count = 0;
  int capacity = 0;  // entries before it overflows; a supernode's is a multiple of a node's
  int blocks = 1;    // capacity in normal nodes
  int stride = 0;    // > capacity: room for the entry that makes it overflow
  bool has_high = false;
  uint64_t epoch = 0;
  std::shared_ptr<Node>* children = nullptr;  // directory nodes
  int64_t* ids = nullptr;                     // leaves
  uint64_t* history = nullptr;                // directory nodes, as in Entry

  bool leaf() const { return level == 0; }
  double* Low(int d) { return rows_ + static_cast<size_t>(d) * row_step_; }
  double* High(int d) { return Low(d) + (has_high ? stride : 0); }
  const double* Low(int d) const { return rows_ + static_cast<size_t>(d) * row_step_; }
  const double* High(int d) const { return Low(d) + (has_high ? stride : 0); }
  size_t row_step() const { return row_step_; }

  void Append(const Entry& entry);
  void AppendObject(const double* low, const double* high, int64_t id);
  void Set(int i, const Entry& entry);
  Entry Get(int i) const;
  void Remove(int i);  // the last entry takes its place
  void Clear();
  // Tight bounds of all entries; count > 0.
  Entry Bounds() const;
  // Copies the bounds of entry i's child from the child; true when they changed.
  bool TightenChild(int i);
  void Grow(int new_capacity, int new_blocks);
  // Takes the content and the capacity of another node of its level, which is left empty.
  void TakeFrom(Node& other);
  int64_t Bytes() const;

 private:
  struct Release {
    void operator()(Node* node) const;
  };

  Node() = default;
  ~Node();
  // Room for `new_stride` entries: behind the header where it fits, else a block of its own.
  // Whatever was there is lost.
  void Allocate(int new_stride);
  void FreeContent();

  double* rows_ = nullptr;
  size_t row_step_ = 0;
  size_t inline_bytes_ = 0;  // behind the header
  std::byte* outside_ = nullptr;
};

bool SameBox(const Node& node, int i, const Entry& entry);

}  // namespace horopter::index_internal
