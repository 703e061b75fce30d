#include "server/vision/features/chain_curvature.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "server/base/status_macros.h"
#include "server/vision/features/ellipse_fit.h"

namespace horopter {
namespace {

constexpr int kMaxHalfWidth = 200;
constexpr int kMinHalfWidth = 2;  // 5 points: as many as an ellipse has parameters
// A radius below the distance of two points cannot be seen in them.
constexpr double kMaxCurvature = 1.0;
// Points that leave their line by less (rms) are on it: what float coordinates round off.
constexpr double kOnLinePx = 1e-3;
// The moments are summed anew this often, so that rounding cannot add up along a long chain.
constexpr int kRefreshSteps = 256;

// Sums of x^i y^j, i + j <= 4, over a window, about an origin that moves along.
class WindowMoments {
 public:
  void Clear() { sums_ = {}; }

  void Add(const Eigen::Vector2d& q, double sign) {
    std::array<double, 5> x, y;
    x[0] = sign;
    y[0] = 1.0;
    for (int k = 1; k < 5; ++k) {
      x[k] = x[k - 1] * q.x();
      y[k] = y[k - 1] * q.y();
    }
    for (int i = 0; i < 5; ++i) {
      for (int j = 0; i + j < 5; ++j) sums_[i][j] += x[i] * y[j];
    }
  }

  // Moves the origin to d: (x - dx)^i (y - dy)^j expanded, one coordinate after the other, highest
  // powers first, so that it can be done in place.
  void MoveOrigin(const Eigen::Vector2d& d) {
    const double dx = d.x(), dy = d.y();
    for (int j = 0; j < 5; ++j) {
      for (int top = 4 - j; top > 0; --top) {
        double power = 1.0, value = 0.0;
        for (int a = top; a >= 0; --a) {
          value += kBinomial[top][a] * power * sums_[a][j];
          power *= -dx;
        }
        sums_[top][j] = value;
      }
    }
    for (int i = 0; i < 5; ++i) {
      for (int top = 4 - i; top > 0; --top) {
        double power = 1.0, value = 0.0;
        for (int b = top; b >= 0; --b) {
          value += kBinomial[top][b] * power * sums_[i][b];
          power *= -dy;
        }
        sums_[i][top] = value;
      }
    }
  }

  double operator()(int i, int j) const { return sums_[i][j]; }

 private:
  static constexpr double kBinomial[5][5] = {
      {1, 0, 0, 0, 0}, {1, 1, 0, 0, 0}, {1, 2, 1, 0, 0}, {1, 3, 3, 1, 0}, {1, 4, 6, 4, 1}};
  std::array<std::array<double, 5>, 5> sums_{};
};

// Smaller standard deviation of the window's points: about their line.
double DeviationFromLine(const WindowMoments& m) {
  const double n = m(0, 0), x = m(1, 0) / n, y = m(0, 1) / n;
  const double xx = m(2, 0) / n - x * x, xy = m(1, 1) / n - x * y, yy = m(0, 2) / n - y * y;
  const double skew = 0.5 * (xx - yy);
  return std::sqrt(std::max(0.5 * (xx + yy) - std::sqrt(skew * skew + xy * xy), 0.0));
}

// Curvature of the window's ellipse at its point seen in the direction of the origin, signed for
// somebody who walks along `tangent`; 0 when there is no ellipse.
double CurvatureOfEllipse(const WindowMoments& m, const Eigen::Vector2d& tangent) {
  constexpr int kPower[6][2] = {{2, 0}, {1, 1}, {0, 2}, {1, 0}, {0, 1}, {0, 0}};
  Eigen::Matrix<double, 6, 6> scatter;
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c) {
      scatter(r, c) = m(kPower[r][0] + kPower[c][0], kPower[r][1] + kPower[c][1]);
    }
  }
  const std::optional<ConicCoefficients> conic = EllipseFromScatter(scatter);
  const std::optional<EllipseArc> e = conic ? EllipseFromConic(*conic) : std::nullopt;
  if (!e) return 0.0;
  const double a = e->semi_major_px, b = e->semi_minor_px;
  const double c = std::cos(e->angle_rad), s = std::sin(e->angle_rad);
  // t0 of thesis 2.3: the origin in the frame of the ellipse, its axes scaled to a circle.
  const Eigen::Vector2d q = -e->center;
  const double u = (c * q.x() + s * q.y()) / a, v = (-s * q.x() + c * q.y()) / b;
  const double radius = std::hypot(u, v);
  if (!(radius > 1e-12)) return 0.0;
  const double cos_t = u / radius, sin_t = v / radius;
  const double root = std::sqrt(b * b * cos_t * cos_t + a * a * sin_t * sin_t);
  const double kappa = a * b / (root * root * root);
  const double side = tangent.x() * e->center.y() - tangent.y() * e->center.x();
  return std::isfinite(kappa) ? std::copysign(kappa, side) : 0.0;
}

double CurvatureOfCircle(const Eigen::Vector2f& a,
                         const Eigen::Vector2f& b,
                         const Eigen::Vector2f& c) {
  const Eigen::Vector2d ab = (b - a).cast<double>(), bc = (c - b).cast<double>(),
                        ac = (c - a).cast<double>();
  const double product = ab.norm() * bc.norm() * ac.norm();
  return product > 0.0 ? 2.0 * (ab.x() * bc.y() - ab.y() * bc.x()) / product : 0.0;
}

}  // namespace

absl::Status Validate(const CurvatureOptions& options) {
  if (options.half_width < kMinHalfWidth || options.half_width > kMaxHalfWidth) {
    return absl::InvalidArgumentError("half_width: need 2 to 200 points, got " +
                                      std::to_string(options.half_width));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<double>> ChainCurvature(std::span<const Eigen::Vector2f> points,
                                                   bool closed,
                                                   const CurvatureOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  for (size_t i = 0; i < points.size(); ++i) {
    if (!points[i].allFinite()) {
      return absl::InvalidArgumentError("chain: point " + std::to_string(i) + " is not finite");
    }
  }
  const int n = static_cast<int>(points.size());
  std::vector<double> curvature(points.size(), 0.0);
  const int l = std::min(options.half_width, (n - 1) / 2);
  if (l < kMinHalfWidth) {
    return curvature;
  }
  const int first = closed ? 0 : l, last = closed ? n - 1 : n - 1 - l;
  const auto at = [&](int i) -> const Eigen::Vector2f& { return points[(i + n) % n]; };
  const double unit = 1.0 / l;  // coordinates of about 1 condition the fit
  WindowMoments moments;
  for (int i = first; i <= last; ++i) {
    const Eigen::Vector2f origin = at(i);
    if (options.method == CurvatureMethod::kCircle) {
      curvature[i] = CurvatureOfCircle(at(i - l), origin, at(i + l));
    } else {
      const auto local = [&](int k) -> Eigen::Vector2d {
        return unit * (at(k) - origin).cast<double>();
      };
      if ((i - first) % kRefreshSteps == 0) {
        moments.Clear();
        for (int k = i - l; k <= i + l; ++k) moments.Add(local(k), 1.0);
      } else {
        moments.MoveOrigin(unit * (origin - at(i - 1)).cast<double>());
        moments.Add(local(i - l - 1), -1.0);
        moments.Add(local(i + l), 1.0);
      }
      if (DeviationFromLine(moments) > kOnLinePx * unit) {
        curvature[i] = unit * CurvatureOfEllipse(moments, local(i + l) - local(i - l));
      }
    }
    curvature[i] = std::clamp(curvature[i], -kMaxCurvature, kMaxCurvature);
  }
  for (int i = 0; i < first; ++i) {
    curvature[i] = curvature[first];
    curvature[n - 1 - i] = curvature[last];
  }
  return curvature;
}

}  // namespace horopter
