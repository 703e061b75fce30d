// The nearest whole number without a call to the library, halves up: asked for every pixel and
// point of a search. The argument fits an int.
#pragma once

#include <cmath>

namespace horopter {

inline int Rounded(float v) {
  return static_cast<int>(std::floor(v + 0.5f));
}
inline int Rounded(double v) {
  return static_cast<int>(std::floor(v + 0.5));
}

}  // namespace horopter
