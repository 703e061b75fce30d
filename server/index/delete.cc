#include <algorithm>
#include <utility>

#include "server/base/status_macros.h"
#include "server/index/node.h"
#include "server/index/x_tree.h"

namespace horopter {

using index_internal::Node;

namespace {

bool Covers(const Node& node, int i, const index_internal::Entry& entry) {
  for (int d = 0; d < node.dimensions; ++d) {
    if (node.Low(d)[i] > entry.low[d] || node.High(d)[i] < entry.high[d]) return false;
  }
  return true;
}

bool FindBelow(const Node& node, const index_internal::Entry& entry, std::vector<int>& path) {
  for (int i = 0; i < node.count; ++i) {
    if (node.leaf()) {
      if (node.ids[i] != entry.id || !SameBox(node, i, entry)) continue;
      path.push_back(i);
      return true;
    }
    if (!Covers(node, i, entry)) continue;
    path.push_back(i);
    if (FindBelow(*node.children[i], entry, path)) return true;
    path.pop_back();
  }
  return false;
}

void CollectObjects(const Node& node, std::vector<index_internal::Entry>& objects) {
  for (int i = 0; i < node.count; ++i) {
    if (node.leaf()) {
      objects.push_back(node.Get(i));
    } else {
      CollectObjects(*node.children[i], objects);
    }
  }
}

}  // namespace

bool XTree::FindEntry(const Entry& entry, std::vector<int>& path) const {
  return FindBelow(*state_.root_, entry, path);
}

absl::Status XTree::Delete(std::span<const double> point, int64_t id) {
  return DeleteBox(point, point, id);
}

absl::Status XTree::DeleteBox(std::span<const double> low,
                              std::span<const double> high,
                              int64_t id) {
  HOROPTER_RETURN_IF_ERROR(CheckBox(low, high));
  Entry entry;
  entry.low.assign(low.begin(), low.end());
  entry.high.assign(high.begin(), high.end());
  entry.id = id;
  std::vector<int> choices;
  if (!FindEntry(entry, choices)) {
    return absl::NotFoundError("no entry with these coordinates and this id");
  }
  std::vector<PathStep> path;
  Node* node = OwnRoot();
  for (const int choice : choices) {
    path.push_back({node, choice});
    if (!node->leaf()) node = Own(node->children[choice]);
  }
  node->Remove(path.back().child);
  --state_.size_;
  Condense(path);
  return absl::OkStatus();
}

// Takes out nodes that have become too small, bottom up, and puts what they held back in;
// supernodes that no longer need their last block lose it.
void XTree::Condense(std::vector<PathStep>& path) {
  std::vector<std::pair<int, Entry>> orphans;  // level of the node they belong in
  for (size_t i = path.size() - 1; i-- > 0;) {
    Node& parent = *path[i].node;
    Node& node = *path[i + 1].node;
    const int base = node.leaf() ? options().leaf_capacity : options().directory_capacity;
    if (node.count < std::max(1, static_cast<int>(options().min_fill * base))) {
      for (int k = 0; k < node.count; ++k) orphans.emplace_back(node.level, node.Get(k));
      parent.Remove(path[i].child);
      continue;
    }
    if (node.blocks > 1 && node.count <= (node.blocks - 1) * base) {
      std::shared_ptr<Node> smaller = NewNode(node.level, (node.count + base - 1) / base);
      for (int k = 0; k < node.count; ++k) smaller->Append(node.Get(k));
      node.TakeFrom(*smaller);
    }
    parent.TightenChild(path[i].child);
  }
  if (state_.root_->count == 0 && !state_.root_->leaf()) state_.root_ = NewNode(0);

  // Highest first. A subtree that no longer fits below the root is taken apart.
  uint64_t no_reinsertion = ~uint64_t{0};
  for (size_t i = orphans.size(); i-- > 0;) {
    auto& [level, entry] = orphans[i];
    if (level <= state_.root_->level) {
      Place(std::move(entry), level, &no_reinsertion);
      continue;
    }
    std::vector<Entry> objects;
    CollectObjects(*entry.child, objects);
    for (Entry& object : objects) Place(std::move(object), 0, &no_reinsertion);
  }
  while (!state_.root_->leaf() && state_.root_->count == 1) {
    state_.root_ = std::shared_ptr<const Node>(state_.root_->children[0]);
  }
}

}  // namespace horopter
