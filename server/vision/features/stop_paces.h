// How often loops over an image's edges look at the stop flag.
#pragma once

namespace horopter {

inline constexpr int kChainsPerLook = 64;
inline constexpr int kComparisonsPerLook = 1 << 14;

}  // namespace horopter
