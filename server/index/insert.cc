#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "server/base/status_macros.h"
#include "server/index/node.h"
#include "server/index/split.h"
#include "server/index/x_tree.h"

namespace horopter {

using index_internal::Node;
using index_internal::Split;

namespace {

// R*-tree: the share of an overflowing node's entries that is reinserted.
constexpr double kReinsertShare = 0.3;
// R*-tree: overlap is compared among this many children of least enlargement.
constexpr size_t kOverlapCandidates = 32;

struct Growth {
  int child = -1;
  double volume = 0.0;
  double volume_growth = 0.0;
  double margin_growth = 0.0;
};

bool LessGrowth(const Growth& a, const Growth& b) {
  if (a.volume_growth != b.volume_growth) return a.volume_growth < b.volume_growth;
  if (a.margin_growth != b.margin_growth) return a.margin_growth < b.margin_growth;
  if (a.volume != b.volume) return a.volume < b.volume;
  return a.child < b.child;
}

Growth GrowthOf(const Node& node, int i, const index_internal::Entry& entry) {
  Growth result{.child = i};
  double before = 1.0, after = 1.0;
  for (int d = 0; d < node.dimensions; ++d) {
    const double low = node.Low(d)[i], high = node.High(d)[i];
    const double grown = std::max(high, entry.high[d]) - std::min(low, entry.low[d]);
    before *= high - low;
    after *= grown;
    result.margin_growth += grown - (high - low);
  }
  result.volume = before;
  result.volume_growth = after - before;
  return result;
}

// By how much child i's overlap with its siblings grows when it takes the entry in.
double OverlapGrowth(const Node& node, int i, const index_internal::Entry& entry) {
  double growth = 0.0;
  for (int j = 0; j < node.count; ++j) {
    if (j == i) continue;
    double before = 1.0, after = 1.0;
    for (int d = 0; d < node.dimensions && after > 0.0; ++d) {
      const double low = node.Low(d)[i], high = node.High(d)[i];
      const double other_low = node.Low(d)[j], other_high = node.High(d)[j];
      before *= std::max(0.0, std::min(high, other_high) - std::max(low, other_low));
      after *= std::max(0.0,
                        std::min(std::max(high, entry.high[d]), other_high) -
                            std::max(std::min(low, entry.low[d]), other_low));
    }
    if (after > 0.0) growth += after - before;
  }
  return growth;
}

// R*-tree, 4.1: above leaves the child whose overlap grows least, higher up whose volume does.
int ChooseSubtree(const Node& node, const index_internal::Entry& entry) {
  std::vector<Growth> growths(node.count);
  for (int i = 0; i < node.count; ++i) growths[i] = GrowthOf(node, i, entry);
  const Growth least = *std::min_element(growths.begin(), growths.end(), LessGrowth);
  // A child that need not grow cannot overlap more.
  if (node.level > 1 || least.margin_growth == 0.0) return least.child;
  const size_t candidates = std::min(kOverlapCandidates, growths.size());
  std::partial_sort(growths.begin(),
                    growths.begin() + static_cast<ptrdiff_t>(candidates),
                    growths.end(),
                    LessGrowth);
  int best = growths[0].child;
  double best_overlap = std::numeric_limits<double>::infinity();
  for (size_t c = 0; c < candidates; ++c) {
    const double overlap = OverlapGrowth(node, growths[c].child, entry);
    if (overlap < best_overlap) {
      best_overlap = overlap;
      best = growths[c].child;
    }
    if (overlap == 0.0) break;  // sorted: none that follows grows less
  }
  return best;
}

void Enlarge(Node& node, int i, const index_internal::Entry& entry) {
  for (int d = 0; d < node.dimensions; ++d) {
    node.Low(d)[i] = std::min(node.Low(d)[i], entry.low[d]);
    node.High(d)[i] = std::max(node.High(d)[i], entry.high[d]);
  }
}

int MinCount(const Node& node, double min_fill) {
  return std::max(1, static_cast<int>(min_fill * node.count));
}

}  // namespace

absl::Status XTree::Insert(std::span<const double> point, int64_t id) {
  return InsertBox(point, point, id);
}

absl::Status XTree::InsertBox(std::span<const double> low,
                              std::span<const double> high,
                              int64_t id) {
  HOROPTER_RETURN_IF_ERROR(CheckBox(low, high));
  Entry entry;
  entry.low.assign(low.begin(), low.end());
  entry.high.assign(high.begin(), high.end());
  entry.id = id;
  uint64_t reinserted_levels = 0;
  Place(std::move(entry), 0, &reinserted_levels);
  ++state_.size_;
  return absl::OkStatus();
}

// Puts the entry into a node of `level`.
void XTree::Place(Entry entry, int level, uint64_t* reinserted_levels) {
  std::vector<PathStep> path{{OwnRoot(), -1}};
  while (path.back().node->level > level) {
    Node* node = path.back().node;
    const int child = ChooseSubtree(*node, entry);
    path.back().child = child;
    Enlarge(*node, child, entry);
    path.push_back({Own(node->children[child]), -1});
  }
  path.back().node->Append(entry);
  if (path.back().node->count > path.back().node->capacity) Overflow(path, reinserted_levels);
}

void XTree::Overflow(std::vector<PathStep>& path, uint64_t* reinserted_levels) {
  while (path.back().node->count > path.back().node->capacity) {
    const uint64_t level = uint64_t{1} << std::min(path.back().node->level, 63);
    if (options().mode == IndexMode::kRStarTree && path.size() > 1 &&
        (*reinserted_levels & level) == 0) {
      *reinserted_levels |= level;
      return Reinsert(path, reinserted_levels);
    }
    if (!SplitNode(path)) return;
    path.pop_back();
  }
}

// R*-tree, 4.3: the entries farthest from the centre are reinserted, the nearest of them first.
void XTree::Reinsert(std::vector<PathStep>& path, uint64_t* reinserted_levels) {
  Node& node = *path.back().node;
  const Entry bounds = node.Bounds();
  std::vector<double> distance(node.count, 0.0);
  for (int d = 0; d < node.dimensions; ++d) {
    const double center = bounds.low[d] + bounds.high[d];
    for (int i = 0; i < node.count; ++i) {
      const double t = node.Low(d)[i] + node.High(d)[i] - center;
      distance[i] += t * t;
    }
  }
  std::vector<int> order(node.count);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(
      order.begin(), order.end(), [&](int a, int b) { return distance[a] < distance[b]; });
  const int kept = node.count - std::max(1, static_cast<int>(kReinsertShare * node.capacity));
  std::vector<Entry> entries;
  for (const int i : order) entries.push_back(node.Get(i));
  node.Clear();
  for (int i = 0; i < kept; ++i) node.Append(entries[i]);
  TightenPath(path);
  const int level = node.level;
  for (size_t i = kept; i < entries.size(); ++i) {
    Place(std::move(entries[i]), level, reinserted_levels);
  }
}

void XTree::TightenPath(const std::vector<PathStep>& path) {
  for (size_t i = path.size() - 1; i-- > 0;) path[i].node->TightenChild(path[i].child);
}

// Divides the last node of the path, which then has a sibling; false when it became a supernode
// instead or the tree grew at the root.
bool XTree::SplitNode(std::vector<PathStep>& path) {
  Node& node = *path.back().node;
  const int min_count = MinCount(node, options().min_fill);
  Split split = TopologicalSplit(node, min_count);
  if (options().mode == IndexMode::kXTree && !node.leaf() &&
      split.overlap > options().max_overlap) {
    std::optional<Split> free = OverlapMinimalSplit(node, min_count);
    if (!free || free->overlap > options().max_overlap) {
      const int blocks = node.blocks + 1;
      node.Grow(blocks * options().directory_capacity, blocks);
      return false;
    }
    split = *std::move(free);
  }

  const int base = node.leaf() ? options().leaf_capacity : options().directory_capacity;
  const auto blocks_for = [&](const std::vector<int>& part) {
    return std::max(1, (static_cast<int>(part.size()) + base - 1) / base);
  };
  std::shared_ptr<Node> sibling = NewNode(node.level, blocks_for(split.second));
  for (const int i : split.second) sibling->Append(node.Get(i));
  std::shared_ptr<Node> kept = NewNode(node.level, blocks_for(split.first));
  for (const int i : split.first) kept->Append(node.Get(i));
  node.TakeFrom(*kept);

  const uint64_t split_bit = uint64_t{1} << split.dimension;
  const auto entry_for = [&](std::shared_ptr<Node> child, uint64_t history) {
    Entry entry = child->Bounds();
    entry.child = std::move(child);
    entry.history = history;
    return entry;
  };
  if (path.size() == 1) {
    std::shared_ptr<Node> old_root = std::const_pointer_cast<Node>(state_.root_);
    std::shared_ptr<Node> root = NewNode(node.level + 1);
    root->Append(entry_for(std::move(old_root), split_bit));
    root->Append(entry_for(std::move(sibling), split_bit));
    state_.root_ = std::move(root);
    return false;
  }
  Node& parent = *path[path.size() - 2].node;
  const int child = path[path.size() - 2].child;
  parent.TightenChild(child);
  parent.history[child] |= split_bit;
  parent.Append(entry_for(std::move(sibling), parent.history[child]));
  return true;
}

}  // namespace horopter
