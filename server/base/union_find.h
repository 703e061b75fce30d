// Disjoint sets of the numbers 0 .. size - 1.
#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

namespace horopter {

class UnionFind {
 public:
  explicit UnionFind(int size = 0) : parent_(size) { std::iota(parent_.begin(), parent_.end(), 0); }

  // One number more, in a set of its own.
  int Add() {
    parent_.push_back(size());
    return parent_.back();
  }
  // The smallest number of its set.
  int Find(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  // False where they were joined before.
  bool Join(int a, int b) {
    a = Find(a);
    b = Find(b);
    parent_[std::max(a, b)] = std::min(a, b);
    return a != b;
  }
  int size() const { return static_cast<int>(parent_.size()); }

 private:
  std::vector<int> parent_;
};

}  // namespace horopter
