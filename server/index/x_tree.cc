#include "server/index/x_tree.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/index/node.h"

namespace horopter {

using index_internal::Node;

absl::Status Validate(const XTreeOptions& options) {
  if (options.dimensions < 1 || options.dimensions > kMaxDimensions) {
    return absl::InvalidArgumentError(
        absl::StrCat("dimensions: ", options.dimensions, " is not in 1..", kMaxDimensions));
  }
  if (options.leaf_capacity < 4) return absl::InvalidArgumentError("leaf_capacity: less than 4");
  if (options.directory_capacity < 4) {
    return absl::InvalidArgumentError("directory_capacity: less than 4");
  }
  // Above 1/2 no split is possible; small nodes then still keep one entry on each side.
  if (!(options.min_fill > 0.0 && options.min_fill <= 0.5)) {
    return absl::InvalidArgumentError("min_fill: not in (0, 0.5]");
  }
  if (!(options.max_overlap >= 0.0 && options.max_overlap <= 1.0)) {
    return absl::InvalidArgumentError("max_overlap: not in [0, 1]");
  }
  if (!(options.scan_share > 0.0)) return absl::InvalidArgumentError("scan_share: not positive");
  return absl::OkStatus();
}

XTree::XTree(const XTreeOptions& options) {
  state_.options_ = options;
  state_.root_ = NewNode(0);
}

absl::StatusOr<XTree> XTree::Create(const XTreeOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  return XTree(options);
}

absl::Status XTree::CheckBox(std::span<const double> low, std::span<const double> high) const {
  const size_t dimensions = options().dimensions;
  if (low.size() != dimensions || high.size() != dimensions) {
    return absl::InvalidArgumentError(
        absl::StrCat("point: has ", low.size(), " coordinates, the index ", dimensions));
  }
  for (size_t d = 0; d < dimensions; ++d) {
    if (!std::isfinite(low[d]) || !std::isfinite(high[d])) {
      return absl::InvalidArgumentError(absl::StrCat("point[", d, "]: not finite"));
    }
    if (low[d] > high[d]) return absl::InvalidArgumentError(absl::StrCat("low[", d, "] > high"));
    if (!options().boxes && low[d] != high[d]) {
      return absl::InvalidArgumentError("box: the index holds points");
    }
  }
  return absl::OkStatus();
}

std::shared_ptr<Node> XTree::NewNode(int level, int blocks) const {
  const int base = level == 0 ? options().leaf_capacity : options().directory_capacity;
  auto node = Node::Make(level, options().dimensions, base * blocks, options().boxes);
  node->blocks = blocks;
  node->epoch = epoch_;
  return node;
}

Node* XTree::Own(std::shared_ptr<Node>& link) {
  if (link->epoch != epoch_) {
    link = Node::Copy(*link);
    link->epoch = epoch_;
  }
  return link.get();
}

Node* XTree::OwnRoot() {
  std::shared_ptr<Node> root = std::const_pointer_cast<Node>(state_.root_);
  Node* own = Own(root);
  state_.root_ = std::move(root);
  return own;
}

XTreeSnapshot XTree::Snapshot() {
  ++epoch_;
  return state_;
}

}  // namespace horopter
