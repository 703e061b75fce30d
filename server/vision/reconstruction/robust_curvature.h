// How stiff a robust cost is along its residual.
#pragma once

#include <algorithm>

#include "server/vision/reconstruction/robust_loss.h"

namespace horopter {

// Second derivative of RobustCost by r, divided by RobustWeight: 1 at r = 0, falling, and not below
// kLeastCurvature where the cost bends the other way. The second-order term of robust least squares
// (Triggs et al. 2000, section 4.3): with weights alone every residual counts 1, steps are half as
// long as they should be, and an adjustment creeps.
inline constexpr double kLeastCurvature = 0.1;

inline double RobustCurvature(RobustLoss loss, double r, double c) {
  const double t2 = (r / c) * (r / c);
  switch (loss) {
    case RobustLoss::kTukey:
      return t2 < 1.0 ? std::max(kLeastCurvature, (1.0 - 5.0 * t2) / (1.0 - t2)) : kLeastCurvature;
    case RobustLoss::kCauchy:
      return std::max(kLeastCurvature, (1.0 - t2) / (1.0 + t2));
    case RobustLoss::kHuber:
      return t2 <= 1.0 ? 1.0 : kLeastCurvature;
    case RobustLoss::kNone:
      break;
  }
  return 1.0;
}

}  // namespace horopter
