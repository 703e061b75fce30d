#pragma once

namespace horopter {

// From a median absolute deviation to the deviation of normal noise.
inline constexpr double kNormalFromMad = 1.4826;

inline constexpr double kMedianOfChiSquare2 = 1.386;  // two degrees of freedom

}  // namespace horopter
