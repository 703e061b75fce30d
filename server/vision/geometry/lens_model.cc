#include "server/vision/geometry/lens_model.h"

#include <cmath>

namespace horopter {
namespace {

Eigen::Vector2d PlumbBob(const std::array<double, 5>& d, const Eigen::Vector2d& n) {
  const double x = n.x(), y = n.y(), r2 = n.squaredNorm();
  const double radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  return {x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
          y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y};
}

Eigen::Vector2d Equidistant(const std::array<double, 5>& d, const Eigen::Vector2d& n) {
  const double r = n.norm();
  if (r < 1e-12) return n;
  const double a = std::atan(r), a2 = a * a;
  return n * (a * (1.0 + a2 * (d[0] + a2 * (d[1] + a2 * (d[2] + a2 * d[3])))) / r);
}

}  // namespace

Eigen::Vector2d DistortedPixel(const LensModel& lens, const Eigen::Vector2d& normalized) {
  const Eigen::Vector2d d = lens.kind == LensModel::Kind::kPlumbBob
                                ? PlumbBob(lens.coefficients, normalized)
                                : Equidistant(lens.coefficients, normalized);
  return {lens.fx * d.x() + lens.cx, lens.fy * d.y() + lens.cy};
}

}  // namespace horopter
