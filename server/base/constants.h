// Constants of mathematics that several folders use.
#pragma once

#include <limits>
#include <numbers>

namespace horopter {

inline constexpr double kPi = std::numbers::pi;
inline constexpr float kPiF = std::numbers::pi_v<float>;
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

}  // namespace horopter
