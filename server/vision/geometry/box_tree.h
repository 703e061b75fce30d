// Boxes in space, found by a point that they hold.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <vector>

namespace horopter {

// Halves of halves of the boxes, each with the box around it. A point that few boxes hold is
// compared with a logarithm of their number. Immutable: threads may share it.
class BoxTree {
 public:
  // Boxes that are empty or not finite are never found.
  explicit BoxTree(std::vector<Eigen::AlignedBox3d> boxes);

  // Whether `test`, called with the number of a box that holds p (borders included), holds for one
  // of them; in no particular order, and no more after the first.
  template <typename Test>
  bool AnyAt(const Eigen::Vector3d& p, const Test& test) const {
    std::array<int, kMostDepth> pending;
    int count = 0;
    if (!nodes_.empty()) pending[count++] = 0;
    while (count > 0) {
      const Node& node = nodes_[pending[--count]];
      if (!node.box.contains(p)) continue;
      if (node.second < 0) {
        for (int i = node.begin; i < node.end; ++i) {
          if (boxes_[order_[i]].contains(p) && test(order_[i])) return true;
        }
        continue;
      }
      pending[count++] = node.second;
      pending[count++] = static_cast<int>(&node - nodes_.data()) + 1;
    }
    return false;
  }

 private:
  static constexpr int kMostDepth = 64;  // of 2^31 boxes: 31, each with one node that waits

  struct Node {
    Eigen::AlignedBox3d box;
    int begin = 0, end = 0;  // of its boxes in order_
    int second = -1;         // its second half; the first follows it. -1: a leaf
  };
  void Build(int begin, int end);

  std::vector<Eigen::AlignedBox3d> boxes_;
  std::vector<int> order_;
  std::vector<Node> nodes_;
};

}  // namespace horopter
