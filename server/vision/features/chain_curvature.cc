#include "server/vision/features/chain_curvature.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "server/base/status_macros.h"
#include "server/vision/features/ellipse_fit.h"

namespace horopter {
namespace {

constexpr int kMaxHalfWidth = 200;  // points; wider windows smooth all corners away
constexpr int kMinHalfWidth = 2;    // 5 points: as many as an ellipse has parameters
// A radius below the distance of two points cannot be seen in them.
constexpr double kMaxCurvature = 1.0;
// Points that leave their line by less (rms) are on it: what float coordinates round off.
constexpr double kOnLinePx = 1e-3;
// A parabola of curvature kappa over the window x in [-1, 1] leaves its line by kappa / 2 x the
// deviation of x^2 (0.33, l = 5) rms. Noise can turn an end of a thin ellipse towards the point,
// where its curvature has no bound; no curvature this many times the parabola's is in the points.
constexpr double kMaxOverParabola = 1.5;
constexpr double kSquareDeviation = 0.33;

// Sums of x^i y^j, i + j <= 4, over a window, about an origin that moves along.
class WindowMoments {
 public:
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

  // Replaces y by y - slope x.
  void Shear(double slope) {
    for (int top = 4; top > 0; --top) {
      for (int i = 0; i + top < 5; ++i) {
        double power = 1.0, value = 0.0;
        for (int b = top; b >= 0; --b) {
          value += kBinomial[top][b] * power * sums_[i + top - b][b];
          power *= -slope;
        }
        sums_[i][top] = value;
      }
    }
  }

  void Scale(double x, double y) {
    double power_x = 1.0;
    for (int i = 0; i < 5; ++i, power_x *= x) {
      double power = power_x;
      for (int j = 0; i + j < 5; ++j, power *= y) sums_[i][j] *= power;
    }
  }

  void SwapAxes() {
    for (int i = 0; i < 5; ++i) {
      for (int j = 0; j < i && i + j < 5; ++j) std::swap(sums_[i][j], sums_[j][i]);
    }
  }

  double operator()(int i, int j) const { return sums_[i][j]; }

 private:
  // Binomial coefficients.
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

// The window's ellipse. The fit does not depend on affine maps of the plane (4 a c - b^2 only
// scales), so it is done where the points have unit covariance: nearly straight ones stay well
// conditioned.
std::optional<EllipseArc> WindowEllipse(WindowMoments m) {
  const bool swap = m(0, 2) - m(0, 1) * m(0, 1) / m(0, 0) > m(2, 0) - m(1, 0) * m(1, 0) / m(0, 0);
  if (swap) m.SwapAxes();
  const double n = m(0, 0), x = m(1, 0) / n, y = m(0, 1) / n;
  m.MoveOrigin({x, y});
  const double slope = m(1, 1) / m(2, 0);
  m.Shear(slope);
  const double sx = std::sqrt(n / m(2, 0)), sy = std::sqrt(n / m(0, 2));
  if (!std::isfinite(sx) || !std::isfinite(sy)) return std::nullopt;
  m.Scale(sx, sy);
  // Of x and y, of a conic's terms.
  constexpr int kPower[6][2] = {{2, 0}, {1, 1}, {0, 2}, {1, 0}, {0, 1}, {0, 0}};
  Eigen::Matrix<double, 6, 6> scatter;
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c) {
      scatter(r, c) = m(kPower[r][0] + kPower[c][0], kPower[r][1] + kPower[c][1]);
    }
  }
  const std::optional<ConicCoefficients> w = EllipseFromScatter(scatter);
  if (!w) return std::nullopt;
  Eigen::Matrix3d C, H;
  C << (*w)[0], 0.5 * (*w)[1], 0.5 * (*w)[3], 0.5 * (*w)[1], (*w)[2], 0.5 * (*w)[4], 0.5 * (*w)[3],
      0.5 * (*w)[4], (*w)[5];
  H << sx, 0.0, -sx * x, -sy * slope, sy, sy * (slope * x - y), 0.0, 0.0, 1.0;
  if (swap) H.col(0).swap(H.col(1));
  const Eigen::Matrix3d D = H.transpose() * C * H;
  ConicCoefficients conic;
  conic << D(0, 0), 2.0 * D(0, 1), D(1, 1), 2.0 * D(0, 2), 2.0 * D(1, 2), D(2, 2);
  return EllipseFromConic(conic);
}

// Curvature of the window's ellipse at its point seen in the direction of the origin, signed for
// somebody who walks along `tangent`; 0 when there is no ellipse.
double CurvatureOfEllipse(const WindowMoments& m, const Eigen::Vector2d& tangent) {
  const std::optional<EllipseArc> e = WindowEllipse(m);
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
    const Eigen::Vector2d origin = at(i).cast<double>();
    if (options.method == CurvatureMethod::kCircle) {
      curvature[i] = CurvatureOfCircle(at(i - l), at(i), at(i + l));
    } else {
      const auto local = [&](int k) -> Eigen::Vector2d {
        return unit * (at(k).cast<double>() - origin);
      };
      if ((i - first) % (2 * l + 1) == 0) {
        moments = {};  // once per window length, so that rounding cannot add up along the chain
        for (int k = i - l; k <= i + l; ++k) moments.Add(local(k), 1.0);
      } else {
        moments.MoveOrigin(unit * (origin - at(i - 1).cast<double>()));
        moments.Add(local(i - l - 1), -1.0);
        moments.Add(local(i + l), 1.0);
      }
      const double deviation = DeviationFromLine(moments);
      if (deviation > kOnLinePx * unit) {
        const double most = kMaxOverParabola * 2.0 * deviation / kSquareDeviation;
        const double kappa = CurvatureOfEllipse(moments, local(i + l) - local(i - l));
        curvature[i] = unit * std::clamp(kappa, -most, most);
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
