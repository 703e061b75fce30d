#include "server/index/node.h"

#include <algorithm>
#include <limits>

namespace horopter::index_internal {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Room for one entry too many, rounded to whole vector registers. Unused places are +infinity,
// which no query reaches.
int StrideFor(int capacity) {
  return (capacity + 1 + 7) / 8 * 8;
}

}  // namespace

Node::Node(int node_level, int dims, int node_capacity, bool boxes)
    : level(node_level), dimensions(dims), capacity(node_capacity), stride(StrideFor(capacity)) {
  low.assign(static_cast<size_t>(dims) * stride, kInfinity);
  if (level > 0 || boxes) high = low;
  if (level == 0) {
    ids.resize(stride);
  } else {
    children.resize(stride);
    history.assign(stride, 0);
  }
}

void Node::Set(int i, const Entry& entry) {
  for (int d = 0; d < dimensions; ++d) {
    low[static_cast<size_t>(d) * stride + i] = entry.low[d];
    if (!high.empty()) high[static_cast<size_t>(d) * stride + i] = entry.high[d];
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
    low[static_cast<size_t>(d) * stride + last] = kInfinity;
    if (!high.empty()) high[static_cast<size_t>(d) * stride + last] = kInfinity;
  }
  if (!leaf()) children[last].reset();
}

void Node::Clear() {
  std::fill(low.begin(), low.end(), kInfinity);
  std::fill(high.begin(), high.end(), kInfinity);
  std::fill(children.begin(), children.end(), nullptr);
  std::fill(history.begin(), history.end(), 0);
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
    double& old_low = low[static_cast<size_t>(d) * stride + i];
    double& old_high = high[static_cast<size_t>(d) * stride + i];
    changed |= old_low != new_low || old_high != new_high;
    old_low = new_low;
    old_high = new_high;
  }
  return changed;
}

void Node::Grow(int new_capacity, int new_blocks) {
  const int new_stride = StrideFor(new_capacity);
  const auto restride = [&](std::vector<double>& values) {
    if (values.empty()) return;
    std::vector<double> moved(static_cast<size_t>(dimensions) * new_stride, kInfinity);
    for (int d = 0; d < dimensions; ++d) {
      std::copy_n(values.begin() + static_cast<ptrdiff_t>(d) * stride,
                  count,
                  moved.begin() + static_cast<ptrdiff_t>(d) * new_stride);
    }
    values = std::move(moved);
  };
  restride(low);
  restride(high);
  if (leaf()) {
    ids.resize(new_stride);
  } else {
    children.resize(new_stride);
    history.resize(new_stride);
  }
  capacity = new_capacity;
  blocks = new_blocks;
  stride = new_stride;
}

int64_t Node::Bytes() const {
  return static_cast<int64_t>(
      sizeof(Node) + 8 * (low.capacity() + high.capacity() + ids.capacity() + history.capacity()) +
      sizeof(std::shared_ptr<Node>) * children.capacity());
}

bool SameBox(const Node& node, int i, const Entry& entry) {
  for (int d = 0; d < node.dimensions; ++d) {
    if (node.Low(d)[i] != entry.low[d] || node.High(d)[i] != entry.high[d]) return false;
  }
  return true;
}

}  // namespace horopter::index_internal
