#include <algorithm>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/index/node.h"
#include "server/index/x_tree.h"

namespace horopter {

using index_internal::Node;

namespace {

void Add(const Node& node, MemoryReport& report) {
  report.bytes += node.Bytes();
  if (node.leaf()) {
    ++report.leaves;
    report.entries += node.count;
    return;
  }
  ++report.directory_nodes;
  if (node.blocks > 1) {
    ++report.supernodes;
    report.largest_supernode = std::max<int64_t>(report.largest_supernode, node.capacity);
  }
  for (int i = 0; i < node.count; ++i) Add(*node.children[i], report);
}

absl::Status Check(const Node& node, const XTreeOptions& options, bool root, int64_t& entries) {
  const auto broken = [&](std::string_view what) {
    return absl::InternalError(absl::StrCat(
        "node of level ", node.level, ", ", node.count, " entries: ", std::string(what)));
  };
  const int base = node.leaf() ? options.leaf_capacity : options.directory_capacity;
  if (node.count > node.capacity) return broken("overfull");
  if (node.capacity != base * node.blocks) return broken("capacity is no multiple of a node's");
  if (node.leaf() && node.blocks != 1) return broken("a leaf that is a supernode");
  const int least =
      root ? (node.leaf() ? 0 : 2) : std::max(1, static_cast<int>(options.min_fill * base));
  if (node.count < least) return broken("underfull");
  if (node.leaf()) {
    entries += node.count;
    return absl::OkStatus();
  }
  for (int i = 0; i < node.count; ++i) {
    const Node& child = *node.children[i];
    if (child.level != node.level - 1) return broken("child of a wrong level");
    if (!SameBox(node, i, child.Bounds())) return broken("bounds of a child are not tight");
    HOROPTER_RETURN_IF_ERROR(Check(child, options, false, entries));
  }
  return absl::OkStatus();
}

void Visit(
    const Node& node,
    const std::function<void(int64_t, std::span<const double>, std::span<const double>)>& visit) {
  double low[kMaxDimensions], high[kMaxDimensions];
  const size_t dimensions = node.dimensions;
  for (int i = 0; i < node.count; ++i) {
    if (node.leaf()) {
      for (int d = 0; d < node.dimensions; ++d) {
        low[d] = node.Low(d)[i];
        high[d] = node.High(d)[i];
      }
      visit(node.ids[i], {low, dimensions}, {high, dimensions});
    } else {
      Visit(*node.children[i], visit);
    }
  }
}

}  // namespace

MemoryReport XTreeSnapshot::Memory() const {
  MemoryReport report;
  if (root_ == nullptr) return report;
  report.height = root_->level + 1;
  Add(*root_, report);
  return report;
}

absl::Status XTreeSnapshot::CheckInvariants() const {
  if (root_ == nullptr) return absl::OkStatus();
  int64_t entries = 0;
  HOROPTER_RETURN_IF_ERROR(Check(*root_, options_, true, entries));
  if (entries != size_) {
    return absl::InternalError(absl::StrCat(entries, " entries, counted ", size_));
  }
  return absl::OkStatus();
}

void XTreeSnapshot::ForEach(
    const std::function<void(int64_t, std::span<const double>, std::span<const double>)>& visit)
    const {
  if (root_ != nullptr) Visit(*root_, visit);
}

}  // namespace horopter
