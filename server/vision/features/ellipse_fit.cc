#include "server/vision/features/ellipse_fit.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "server/vision/features/ellipse_frame.h"

namespace horopter {
namespace {

// Least determinant of the scatter of (x, y, 1) per point cubed: below, the points lie on a line.
constexpr double kMinSpread = 1e-14;

// Largest real root of x^3 - trace x^2 + minors x - determinant, all of whose roots are real.
double LargestRoot(double trace, double minors, double determinant) {
  const double third = trace / 3.0;
  const double q = std::max(third * third - minors / 3.0, 0.0);
  const double r = third * third * third - 0.5 * (third * minors - determinant);
  const double cube = q * std::sqrt(q);
  const double angle = cube > 0.0 ? std::acos(std::clamp(r / cube, -1.0, 1.0)) : 0.0;
  double x = third + 2.0 * std::sqrt(q) * std::cos(angle / 3.0);
  for (int i = 0; i < 2; ++i) {  // what the cosine rounds off
    const double value = ((x - trace) * x + minors) * x - determinant;
    const double slope = (3.0 * x - 2.0 * trace) * x + minors;
    if (!(std::abs(slope) > 1e-300)) break;
    x -= value / slope;
  }
  return x;
}

// Sums of x^i y^j over points, of all monomials that the scatter of conics is made of.
struct PowerSums {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0, xxx = 0, xxy = 0, xyy = 0, yyy = 0, xxxx = 0,
         xxxy = 0, xxyy = 0, xyyy = 0, yyyy = 0;

  void Add(double px, double py) {
    const double pxx = px * px, pxy = px * py, pyy = py * py;
    n += 1.0;
    x += px;
    y += py;
    xx += pxx;
    xy += pxy;
    yy += pyy;
    xxx += pxx * px;
    xxy += pxx * py;
    xyy += pyy * px;
    yyy += pyy * py;
    xxxx += pxx * pxx;
    xxxy += pxx * pxy;
    xxyy += pxx * pyy;
    xyyy += pyy * pxy;
    yyyy += pyy * pyy;
  }

  Eigen::Matrix<double, 6, 6> Scatter() const {
    Eigen::Matrix<double, 6, 6> S;
    S << xxxx, xxxy, xxyy, xxx, xxy, xx,  //
        xxxy, xxyy, xyyy, xxy, xyy, xy,   //
        xxyy, xyyy, yyyy, xyy, yyy, yy,   //
        xxx, xxy, xyy, xx, xy, x,         //
        xxy, xyy, yyy, xy, yy, y,         //
        xx, xy, yy, x, y, n;
    return S;
  }
};

}  // namespace

std::optional<ConicCoefficients> EllipseFromScatter(const Eigen::Matrix<double, 6, 6>& scatter) {
  const Eigen::Matrix3d S1 = scatter.topLeftCorner<3, 3>(), S2 = scatter.topRightCorner<3, 3>(),
                        S3 = scatter.bottomRightCorner<3, 3>();
  const double count = scatter(5, 5);
  if (!(std::abs(S3.determinant()) > kMinSpread * count * count * count)) {
    return std::nullopt;
  }
  const Eigen::Matrix3d T = -S3.inverse() * S2.transpose();
  const Eigen::Matrix3d M = S1 + S2 * T;
  // Inverse of the constraint matrix C (4 a c - b^2 = v^T C v) times M.
  Eigen::Matrix3d system;
  system << 0.5 * M.row(2), -M.row(1), 0.5 * M.row(0);
  if (!system.allFinite()) {
    return std::nullopt;
  }
  const double minors = 0.5 * (system.trace() * system.trace() - (system * system).trace());
  const double root = LargestRoot(system.trace(), minors, system.determinant());
  const Eigen::Matrix3d rest = system - root * Eigen::Matrix3d::Identity();
  Eigen::Vector3d v = Eigen::Vector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d cross =
        rest.row(k).transpose().cross(Eigen::Vector3d(rest.row((k + 1) % 3).transpose()));
    if (cross.squaredNorm() > v.squaredNorm()) v = cross;
  }
  v.normalize();
  const double discriminant = 4.0 * v[0] * v[2] - v[1] * v[1];
  if (!(discriminant > 0.0)) {
    return std::nullopt;
  }
  ConicCoefficients conic;
  conic << v, T * v;
  return conic / std::sqrt(discriminant);
}

std::optional<EllipseArc> EllipseFromConic(const ConicCoefficients& conic) {
  const double a = conic[0], b = conic[1], c = conic[2], d = conic[3], e = conic[4], f = conic[5];
  const double determinant = 4.0 * a * c - b * b;
  if (!(determinant > 0.0)) {
    return std::nullopt;
  }
  EllipseArc arc;
  arc.center = {(b * e - 2.0 * c * d) / determinant, (b * d - 2.0 * a * e) / determinant};
  const double at_center = f + 0.5 * (d * arc.center.x() + e * arc.center.y());
  const double root = std::hypot(a - c, b);
  // Eigenvalues of the quadratic part; the smaller one (in size) belongs to the major axis.
  double small = 0.5 * (a + c - root), large = 0.5 * (a + c + root);
  if (a + c < 0.0) {
    std::swap(small, large);
  }
  const double major = -at_center / small, minor = -at_center / large;
  if (!(major > 0.0) || !(minor > 0.0)) {
    return std::nullopt;
  }
  arc.semi_major_px = std::sqrt(major);
  arc.semi_minor_px = std::sqrt(minor);
  // Direction of the major axis: eigenvector of `small`.
  const double sign = a + c < 0.0 ? -1.0 : 1.0;
  arc.angle_rad = 0.5 * std::atan2(-sign * b, -sign * (a - c));
  return arc;
}

std::optional<EllipseArc> FitWholeEllipse(std::span<const Eigen::Vector2f> points) {
  if (points.size() < 6) {
    return std::nullopt;
  }
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2f& p : points) {
    mean += p.cast<double>();
  }
  mean /= static_cast<double>(points.size());
  double scale = 0.0;
  for (const Eigen::Vector2f& p : points) {
    scale += (p.cast<double>() - mean).squaredNorm();
  }
  scale = std::sqrt(scale / static_cast<double>(points.size()));
  if (!(scale > 1e-9)) {
    return std::nullopt;
  }
  PowerSums sums;
  for (const Eigen::Vector2f& p : points) {
    const Eigen::Vector2d q = (p.cast<double>() - mean) / scale;
    sums.Add(q.x(), q.y());
  }
  const std::optional<ConicCoefficients> conic = EllipseFromScatter(sums.Scatter());
  std::optional<EllipseArc> arc = conic ? EllipseFromConic(*conic) : std::nullopt;
  if (!arc) {
    return std::nullopt;
  }
  arc->center = mean + scale * arc->center;
  arc->semi_major_px *= scale;
  arc->semi_minor_px *= scale;
  const EllipseFrame frame(*arc);
  double square = 0.0;
  for (const Eigen::Vector2f& p : points) {
    const double distance = frame.DistanceOf(p.cast<double>());
    square += distance * distance;
  }
  arc->rms_px = std::sqrt(square / static_cast<double>(points.size()));
  return arc;
}

std::optional<EllipseArc> FitEllipse(std::span<const Eigen::Vector2f> points) {
  std::optional<EllipseArc> arc = FitWholeEllipse(points);
  if (arc) SpanInOrder(points, &*arc);
  return arc;
}

double EllipseDistance(const EllipseArc& ellipse, const Eigen::Vector2d& point) {
  return EllipseFrame(ellipse).DistanceOf(point);
}

Eigen::Vector2d NearestOnEllipse(const EllipseArc& ellipse, const Eigen::Vector2d& point) {
  const double c = std::cos(ellipse.angle_rad), s = std::sin(ellipse.angle_rad);
  const double a = ellipse.semi_major_px, b = ellipse.semi_minor_px;
  const Eigen::Vector2d q = point - ellipse.center;
  const double u = c * q.x() + s * q.y(), v = -s * q.x() + c * q.y();
  const double x = std::abs(u), y = std::abs(v);
  double px = 0.0, py = 0.0;
  const double e = a * a - b * b;
  if (y > 0.0) {
    // The foot is (a^2 x / (s + e), b^2 y / s); s solves value(s) = 0 (Eberly 2013). Newton's steps
    // on this convex falling function rise to the root from any s left of it; near the major axis,
    // where they are short, halving the ratio of the bounds helps.
    const auto value = [&](double s_at) {
      const double r = a * x / (s_at + e), w = b * y / s_at;
      return r * r + w * w - 1.0;
    };
    double low = std::max(b * y, a * x - e), high = std::hypot(a * x, b * y);
    for (int i = 0; i < 60; ++i) {
      const double r = a * x / (low + e), w = b * y / low;
      double next = low + 0.5 * value(low) / (r * r / (low + e) + w * w / low);
      if (const double middle = std::sqrt(low * high); next < middle) {
        if (value(middle) >= 0.0) {
          next = middle;
        } else {
          high = middle;
        }
      }
      if (!(next > low * (1.0 + 1e-15))) break;
      low = next;
    }
    px = a * a * x / (low + e);
    py = b * b * y / low;
  } else if (a * x < e) {
    px = a * a * x / e;
    py = b * std::sqrt(std::max(1.0 - px * px / (a * a), 0.0));
  } else {
    px = a;
  }
  px = std::copysign(px, u);
  py = std::copysign(py, v);
  return ellipse.center + Eigen::Vector2d(c * px - s * py, s * px + c * py);
}

void SpanInOrder(std::span<const Eigen::Vector2f> points, EllipseArc* arc) {
  const EllipseFrame frame(*arc);
  double travel = 0.0;
  const double first = frame.AngleOf(points.front().cast<double>());
  double previous = first;
  double lowest = 0.0, highest = 0.0;
  for (const Eigen::Vector2f& p : points) {
    const double angle = frame.AngleOf(p.cast<double>());
    const double turn = angle - previous;  // the shorter way
    travel += turn > M_PI ? turn - 2.0 * M_PI : turn < -M_PI ? turn + 2.0 * M_PI : turn;
    previous = angle;
    lowest = std::min(lowest, travel);
    highest = std::max(highest, travel);
  }
  arc->start_rad = first + lowest;
  arc->sweep_rad = std::min(highest - lowest, 2.0 * M_PI);
}

double SpanOf(std::span<const Eigen::Vector2f> points, EllipseArc* arc) {
  constexpr int kBins = 72;  // 5 degrees
  const EllipseFrame frame(*arc);
  std::array<bool, kBins> filled{};
  for (const Eigen::Vector2f& p : points) {
    const double turn = frame.AngleOf(p.cast<double>()) / (2.0 * M_PI);
    filled[static_cast<int>((turn - std::floor(turn)) * kBins) % kBins] = true;
  }
  int longest = 0, gap_end = 0, run = 0;
  for (int k = 0; k < 2 * kBins; ++k) {
    run = filled[k % kBins] ? 0 : run + 1;
    if (run > longest && run <= kBins) {
      longest = run;
      gap_end = (k + 1) % kBins;
    }
  }
  if (longest <= 2) {
    longest = 0;  // closed up to the bin size
  }
  const double width = 2.0 * M_PI / kBins;
  arc->start_rad = gap_end * width;
  arc->sweep_rad = (kBins - longest) * width;
  int covered = 0;
  for (int k = 0; k < kBins - longest; ++k) {
    const int bin = (gap_end + k) % kBins;
    covered +=
        filled[bin] || filled[(bin + 1) % kBins] || filled[(bin + kBins - 1) % kBins] ? 1 : 0;
  }
  return longest == kBins ? 0.0 : static_cast<double>(covered) / (kBins - longest);
}

}  // namespace horopter
