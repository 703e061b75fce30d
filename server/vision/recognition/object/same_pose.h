// Whether two poses are one.
#pragma once

#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

struct SamePoseLimits {
  double turn_rad = 0.0;
  double shift_diameters = 0.0;  // of the object's centre
};

// Of placements before they are refined: nearer ones are refined into each other.
inline constexpr SamePoseLimits kSamePlacement{0.25, 0.1};
// Of refined and answered poses: what differs by more can be seen in the images.
inline constexpr SamePoseLimits kSameAnswer{0.09, 0.02};

// Whether `a`, turned by the identity or a symmetry of the object, is `b` within the limits.
bool IsSamePose(const PreparedObject& object,
                const Rigid3& a,
                const Rigid3& b,
                const SamePoseLimits& limits);

}  // namespace horopter
