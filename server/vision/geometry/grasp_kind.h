// Grasps of suction cups among those of two fingers.
#pragma once

#include "server/vision/geometry/object_model.h"

namespace horopter {

// The gripper frame of a suction cup has its origin in the middle of the rim, on the part; z =
// approach. A Grasp holds it as an opening that no fingers can have and the rim's diameter as
// width.
inline constexpr double kSuctionOpening = -1.0;

inline bool IsSuction(const Grasp& grasp) {
  return grasp.jaw_opening_m == kSuctionOpening;
}
inline double CupRadius(const Grasp& grasp) {
  return 0.5 * grasp.grip_width_m;
}
inline void SetSuction(double cup_radius_m, Grasp* grasp) {
  grasp->jaw_opening_m = kSuctionOpening;
  grasp->grip_width_m = 2.0 * cup_radius_m;
}

}  // namespace horopter
