// What every way to a reconstruction believes of its points and cameras.
#pragma once

namespace horopter {

inline constexpr double kMinRayAngle = 0.0175;  // 1 degree: below it depth is noise
// The posterior deviation of log f knows nothing of wrong matches that survive. With the principal
// points' share beside it, the factor makes rms(error / deviation) about 1 on parts-train.
inline constexpr double kFocalInflation = 3.0;

}  // namespace horopter
