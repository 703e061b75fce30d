// Distance of homogeneous quantities.
#pragma once

#include <Eigen/Core>
#include <algorithm>

namespace horopter {

// Of the two at norm one, over the sign that brings them nearer.
template <typename A, typename B>
double Apart(const A& a, const B& b) {
  const auto x = (a / a.norm()).eval();
  const auto y = (b / b.norm()).eval();
  return std::min((x - y).norm(), (x + y).norm());
}

}  // namespace horopter
