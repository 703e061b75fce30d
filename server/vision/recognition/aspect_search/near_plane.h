#pragma once

namespace horopter {

// Metres; points nearer to the camera plane have no image.
inline constexpr double kNearM = 1e-3;

}  // namespace horopter
