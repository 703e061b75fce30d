// Sizes of a page of any List method.
#pragma once

namespace horopter {

inline constexpr int kDefaultPageSize = 50;
inline constexpr int kMaxPageSize = 1000;

}  // namespace horopter
