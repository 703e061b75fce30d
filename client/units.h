#pragma once

namespace horopter {

inline constexpr double kMetresPerMm = 1e-3;
inline constexpr double kMmPerMetre = 1e3;

}  // namespace horopter
