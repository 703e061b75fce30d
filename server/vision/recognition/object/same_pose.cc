#include "server/vision/recognition/object/same_pose.h"

#include <algorithm>
#include <cmath>

namespace horopter {

bool IsSamePose(const PreparedObject& object,
                const Rigid3& a,
                const Rigid3& b,
                const SamePoseLimits& limits) {
  const auto close = [&](const Rigid3& x) {
    const double cosine = 0.5 * ((x.R.transpose() * b.R).trace() - 1.0);
    return cosine > std::cos(limits.turn_rad) &&
           (x * object.center - b * object.center).norm() <
               limits.shift_diameters * object.model.diameter_m;
  };
  return close(a) || std::any_of(object.model.symmetries.begin(),
                                 object.model.symmetries.end(),
                                 [&](const Rigid3& s) { return close(a * s); });
}

}  // namespace horopter
