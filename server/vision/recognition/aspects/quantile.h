// Order statistics of a list, which they reorder.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace horopter {

// The value that `share` (0 .. 1) of the others lie below; zero of none.
template <typename T>
T Quantile(double share, std::vector<T>* values) {
  if (values->empty()) return T{};
  const auto at = values->begin() + static_cast<std::ptrdiff_t>(share * (values->size() - 1));
  std::nth_element(values->begin(), at, values->end());
  return *at;
}

// The upper one of an even number; zero of none.
template <typename T>
T Median(std::vector<T>* values) {
  if (values->empty()) return T{};
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

}  // namespace horopter
