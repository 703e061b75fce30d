#include "server/vision/geometry/box_tree.h"

#include <algorithm>
#include <utility>

namespace horopter {
namespace {

constexpr int kLeafBoxes = 4;

}  // namespace

BoxTree::BoxTree(std::vector<Eigen::AlignedBox3d> boxes) : boxes_(std::move(boxes)) {
  for (int i = 0; i < static_cast<int>(boxes_.size()); ++i) {
    const Eigen::AlignedBox3d& box = boxes_[i];
    if (box.min().allFinite() && box.max().allFinite() && !box.isEmpty()) order_.push_back(i);
  }
  if (!order_.empty()) Build(0, static_cast<int>(order_.size()));
}

void BoxTree::Build(int begin, int end) {
  const std::size_t number = nodes_.size();
  nodes_.emplace_back();
  Node node;
  node.begin = begin;
  node.end = end;
  Eigen::AlignedBox3d middles;
  for (int i = begin; i < end; ++i) {
    node.box.extend(boxes_[order_[i]]);
    middles.extend(boxes_[order_[i]].center());
  }
  if (end - begin > kLeafBoxes) {
    int axis = 0;
    middles.sizes().maxCoeff(&axis);
    // By number and not by place: halves are equal wherever the boxes lie, on one point too.
    const int half = begin + (end - begin) / 2;
    std::nth_element(
        order_.begin() + begin, order_.begin() + half, order_.begin() + end, [&](int a, int b) {
          return std::pair(boxes_[a].center()[axis], a) < std::pair(boxes_[b].center()[axis], b);
        });
    Build(begin, half);
    node.second = static_cast<int>(nodes_.size());
    Build(half, end);
  }
  nodes_[number] = node;
}

}  // namespace horopter
