#include "server/vision/geometry/lens_model.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace horopter {
namespace {

constexpr double kMostRay = 20.0;  // 87 degrees
// Of the angle to the axis, radians, at which the radial part is looked at.
constexpr double kStepRad = 0.002;
// A calibration says little of an image's outermost corners.
constexpr double kCornerShare = 0.97;

// Factor of a ray's distance from the axis.
double Radial(const LensModel& lens, double r2) {
  const auto& d = lens.coefficients;
  const auto& q = lens.denominator;
  return (1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))) /
         (1.0 + r2 * (q[0] + r2 * (q[1] + r2 * q[2])));
}

// Distance from the axis in the image of a ray under this angle.
double OfAngle(const LensModel& lens, double a) {
  const auto& d = lens.coefficients;
  if (lens.kind == LensModel::Kind::kEquidistant) {
    const double a2 = a * a;
    return a * (1.0 + a2 * (d[0] + a2 * (d[1] + a2 * (d[2] + a2 * d[3]))));
  }
  const double r = std::tan(a);
  return r * Radial(lens, r * r);
}

Eigen::Vector2d PlumbBob(const LensModel& lens, const Eigen::Vector2d& n) {
  const auto& d = lens.coefficients;
  const double x = n.x(), y = n.y(), r2 = n.squaredNorm();
  const double radial = Radial(lens, r2);
  return {x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
          y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y};
}

Eigen::Vector2d Equidistant(const LensModel& lens, const Eigen::Vector2d& n) {
  const double r = n.norm();
  if (r < 1e-12) return n;
  return n * (OfAngle(lens, std::atan(r)) / r);
}

}  // namespace

Eigen::Vector2d DistortedPixel(const LensModel& lens, const Eigen::Vector2d& normalized) {
  const Eigen::Vector2d d = lens.kind == LensModel::Kind::kPlumbBob ? PlumbBob(lens, normalized)
                                                                    : Equidistant(lens, normalized);
  return {lens.fx * d.x() + lens.cx, lens.fy * d.y() + lens.cy};
}

LensReach ReachOf(const LensModel& lens) {
  double before = 0.0;
  for (double a = kStepRad; std::tan(a) < kMostRay; a += kStepRad) {
    const double now = OfAngle(lens, a);
    // Not a number, or a pole of the denominator: no ray either.
    if (!(now > before) || now > 1e3) return {std::tan(a - kStepRad), before};
    before = now;
  }
  constexpr double kAll = std::numeric_limits<double>::infinity();
  return {kAll, kAll};
}

bool FoldsImage(const LensModel& lens, int width, int height) {
  const double x = std::max(lens.cx + 0.5, width - 0.5 - lens.cx) / lens.fx;
  const double y = std::max(lens.cy + 0.5, height - 0.5 - lens.cy) / lens.fy;
  return ReachOf(lens).image < kCornerShare * std::hypot(x, y);
}

}  // namespace horopter
