// Robust weights and costs of a residual length in sigmas (thesis 3.4.2).
#pragma once

#include <algorithm>
#include <cmath>

namespace horopter {

enum class RobustLoss {
  kNone,    // r^2 / 2
  kTukey,   // Beaton-Tukey: redescending, an outlier has no weight; needs a good start
  kCauchy,  // outliers keep a small weight
  kHuber,   // convex; outliers pull with constant force
};

// Scales at which 95 % efficiency is kept for normal residuals.
inline double TuningConstant(RobustLoss loss) {
  switch (loss) {
    case RobustLoss::kTukey:
      return 4.685;
    case RobustLoss::kCauchy:
      return 2.385;
    case RobustLoss::kHuber:
      return 1.345;
    case RobustLoss::kNone:
      break;
  }
  return 1.0;
}

// Weight of iteratively reweighted least squares, 1 at r = 0. `c` > 0 is the scale, r >= 0. Not a
// number counts as infinitely far.
inline double RobustWeight(RobustLoss loss, double r, double c) {
  if (!(r < 1e12)) return 0.0;
  const double t = r / c;
  switch (loss) {
    case RobustLoss::kTukey:
      return t < 1.0 ? (1.0 - t * t) * (1.0 - t * t) : 0.0;
    case RobustLoss::kCauchy:
      return 1.0 / (1.0 + t * t);
    case RobustLoss::kHuber:
      return t <= 1.0 ? 1.0 : 1.0 / t;
    case RobustLoss::kNone:
      break;
  }
  return 1.0;
}

// The cost whose derivative by r is RobustWeight r; figure 3.1 of the thesis for kTukey, where it
// is c^2 / 6 (1 - (1 - (r/c)^2)^3) up to c and constant beyond.
inline double RobustCost(RobustLoss loss, double r, double c) {
  const double t = r / c;
  switch (loss) {
    case RobustLoss::kTukey:
      return c * c / 6.0 * (t < 1.0 ? 1.0 - (1.0 - t * t) * (1.0 - t * t) * (1.0 - t * t) : 1.0);
    case RobustLoss::kCauchy:
      return 0.5 * c * c * std::log1p(t * t);
    case RobustLoss::kHuber:
      return t <= 1.0 ? 0.5 * r * r : c * (r - 0.5 * c);
    case RobustLoss::kNone:
      break;
  }
  return 0.5 * r * r;
}

}  // namespace horopter
