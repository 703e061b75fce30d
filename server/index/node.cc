#include "server/index/node.h"

#include <algorithm>
#include <cstring>
#include <new>
#include <utility>

#include "server/base/constants.h"

namespace horopter::index_internal {
namespace {

constexpr std::align_val_t kCacheLine{64};

size_t HeaderBytes() {
  return (sizeof(Node) + 63) / 64 * 64;
}

// Room for one entry too many, rounded to whole vector registers. Unused places are +infinity,
// which no query reaches.
int StrideFor(int capacity) {
  return (capacity + 1 + 3) / 4 * 4;
}

size_t RowBytes(int dimensions, bool has_high, int stride) {
  return sizeof(double) * dimensions * (has_high ? 2 : 1) * static_cast<size_t>(stride);
}

size_t ContentBytes(int level, int dimensions, bool has_high, int stride) {
  const size_t per_entry =
      level == 0 ? sizeof(int64_t) : sizeof(std::shared_ptr<Node>) + sizeof(uint64_t);
  return RowBytes(dimensions, has_high, stride) + per_entry * static_cast<size_t>(stride);
}

}  // namespace

void Node::Release::operator()(Node* node) const {
  node->~Node();
  ::operator delete(static_cast<void*>(node), kCacheLine);
}

std::shared_ptr<Node> Node::Make(int level, int dimensions, int capacity, bool boxes) {
  const bool has_high = level > 0 || boxes;
  const int stride = StrideFor(capacity);
  const size_t content = ContentBytes(level, dimensions, has_high, stride);
  void* block = ::operator new(HeaderBytes() + content, kCacheLine);
  std::shared_ptr<Node> node(new (block) Node, Release());
  node->level = level;
  node->dimensions = dimensions;
  node->capacity = capacity;
  node->has_high = has_high;
  node->inline_bytes_ = content;
  node->Allocate(stride);
  return node;
}

std::shared_ptr<Node> Node::Copy(const Node& node) {
  std::shared_ptr<Node> copy =
      Make(node.level, node.dimensions, node.capacity, node.leaf() && node.has_high);
  copy->blocks = node.blocks;
  copy->epoch = node.epoch;
  copy->count = node.count;
  std::memcpy(copy->rows_, node.rows_, RowBytes(node.dimensions, node.has_high, node.stride));
  if (node.leaf()) {
    std::copy_n(node.ids, node.count, copy->ids);
  } else {
    std::copy_n(node.children, node.count, copy->children);
    std::copy_n(node.history, node.count, copy->history);
  }
  return copy;
}

Node::~Node() {
  FreeContent();
}

void Node::FreeContent() {
  if (children != nullptr) std::destroy_n(children, stride);
  children = nullptr;
  if (outside_ != nullptr) ::operator delete(static_cast<void*>(outside_), kCacheLine);
  outside_ = nullptr;
}

void Node::Allocate(int new_stride) {
  FreeContent();
  stride = new_stride;
  const size_t bytes = ContentBytes(level, dimensions, has_high, stride);
  std::byte* at = reinterpret_cast<std::byte*>(this) + HeaderBytes();
  if (bytes > inline_bytes_) {
    outside_ = static_cast<std::byte*>(::operator new(bytes, kCacheLine));
    at = outside_;
  }
  row_step_ = static_cast<size_t>(stride) * (has_high ? 2 : 1);
  const size_t row_bytes = RowBytes(dimensions, has_high, stride);
  rows_ = reinterpret_cast<double*>(at);
  std::fill_n(rows_, row_bytes / sizeof(double), kInfinity);
  at += row_bytes;
  if (leaf()) {
    ids = reinterpret_cast<int64_t*>(at);
  } else {
    children = reinterpret_cast<std::shared_ptr<Node>*>(at);
    std::uninitialized_value_construct_n(children, stride);
    history = reinterpret_cast<uint64_t*>(at + sizeof(std::shared_ptr<Node>) * stride);
    std::fill_n(history, stride, uint64_t{0});
  }
}

void Node::Set(int i, const Entry& entry) {
  for (int d = 0; d < dimensions; ++d) {
    Low(d)[i] = entry.low[d];
    if (has_high) High(d)[i] = entry.high[d];
  }
  if (leaf()) {
    ids[i] = entry.id;
  } else {
    children[i] = entry.child;
    history[i] = entry.history;
  }
}

void Node::Append(const Entry& entry) {
  Set(count++, entry);
}

void Node::AppendObject(const double* low, const double* high, int64_t id) {
  for (int d = 0; d < dimensions; ++d) {
    Low(d)[count] = low[d];
    if (has_high) High(d)[count] = high[d];
  }
  ids[count++] = id;
}

Entry Node::Get(int i) const {
  Entry entry;
  entry.low.resize(dimensions);
  entry.high.resize(dimensions);
  for (int d = 0; d < dimensions; ++d) {
    entry.low[d] = Low(d)[i];
    entry.high[d] = High(d)[i];
  }
  if (leaf()) {
    entry.id = ids[i];
  } else {
    entry.child = children[i];
    entry.history = history[i];
  }
  return entry;
}

void Node::Remove(int i) {
  const int last = --count;
  if (i != last) Set(i, Get(last));
  for (int d = 0; d < dimensions; ++d) {
    Low(d)[last] = kInfinity;
    if (has_high) High(d)[last] = kInfinity;
  }
  if (!leaf()) children[last].reset();
}

void Node::Clear() {
  std::fill_n(rows_, row_step_ * dimensions, kInfinity);
  if (!leaf()) {
    std::fill_n(children, stride, nullptr);
    std::fill_n(history, stride, uint64_t{0});
  }
  count = 0;
}

Entry Node::Bounds() const {
  Entry bounds;
  bounds.low.resize(dimensions);
  bounds.high.resize(dimensions);
  for (int d = 0; d < dimensions; ++d) {
    bounds.low[d] = *std::min_element(Low(d), Low(d) + count);
    bounds.high[d] = *std::max_element(High(d), High(d) + count);
  }
  return bounds;
}

bool Node::TightenChild(int i) {
  const Node& child = *children[i];
  bool changed = false;
  for (int d = 0; d < dimensions; ++d) {
    const double new_low = *std::min_element(child.Low(d), child.Low(d) + child.count);
    const double new_high = *std::max_element(child.High(d), child.High(d) + child.count);
    changed |= Low(d)[i] != new_low || High(d)[i] != new_high;
    Low(d)[i] = new_low;
    High(d)[i] = new_high;
  }
  return changed;
}

void Node::Grow(int new_capacity, int new_blocks) {
  const std::shared_ptr<Node> larger = Make(level, dimensions, new_capacity, leaf() && has_high);
  larger->blocks = new_blocks;
  for (int i = 0; i < count; ++i) larger->Append(Get(i));
  TakeFrom(*larger);
}

void Node::TakeFrom(Node& other) {
  capacity = other.capacity;
  blocks = other.blocks;
  Allocate(other.stride);
  count = std::exchange(other.count, 0);
  std::memcpy(rows_, other.rows_, RowBytes(dimensions, has_high, stride));
  if (leaf()) {
    std::copy_n(other.ids, count, ids);
    return;
  }
  std::move(other.children, other.children + count, children);
  std::copy_n(other.history, count, history);
}

int64_t Node::Bytes() const {
  constexpr size_t kControlBlock = 48;  // of the shared_ptr, with the allocator's overhead
  const size_t outside =
      outside_ != nullptr ? ContentBytes(level, dimensions, has_high, stride) : 0;
  return static_cast<int64_t>(HeaderBytes() + inline_bytes_ + outside + kControlBlock);
}

bool SameBox(const Node& node, int i, const Entry& entry) {
  for (int d = 0; d < node.dimensions; ++d) {
    if (node.Low(d)[i] != entry.low[d] || node.High(d)[i] != entry.high[d]) return false;
  }
  return true;
}

}  // namespace horopter::index_internal
