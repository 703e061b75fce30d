#include "server/vision/geometry/plucker_line.h"

#include <Eigen/Dense>
#include <cmath>

namespace horopter {
namespace {

// Directions whose cross product is smaller than this share of their norms are parallel.
constexpr double kParallel = 1e-9;

// A unit vector perpendicular to v.
Eigen::Vector3d Perpendicular(const Eigen::Vector3d& v) {
  int smallest = 0;
  v.cwiseAbs().minCoeff(&smallest);
  return v.cross(Eigen::Vector3d::Unit(smallest)).normalized();
}

}  // namespace

Eigen::Matrix3d CrossMatrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Matrix4d PluckerMatrix(const PluckerLine& line) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Zero();
  m.topLeftCorner<3, 3>() = -CrossMatrix(line.tail<3>());
  m.topRightCorner<3, 1>() = -line.head<3>();
  m.bottomLeftCorner<1, 3>() = line.head<3>().transpose();
  return m;
}

Eigen::Matrix4d DualPluckerMatrix(const PluckerLine& line) {
  return PluckerMatrix(DualLine(line));
}

PluckerLine LineOfMatrix(const Eigen::Matrix4d& skew) {
  PluckerLine line;
  line << skew(3, 0), skew(3, 1), skew(3, 2), skew(1, 2), skew(2, 0), skew(0, 1);
  return line;
}

PluckerLine DualLine(const PluckerLine& line) {
  PluckerLine dual;
  dual << line.tail<3>(), line.head<3>();
  return dual;
}

PluckerLine JoinPoints(const Eigen::Vector4d& a, const Eigen::Vector4d& b) {
  PluckerLine line;
  line << a.w() * b.head<3>() - b.w() * a.head<3>(), a.head<3>().cross(b.head<3>());
  return line;
}

Eigen::Vector4d JoinLinePoint(const PluckerLine& line, const Eigen::Vector4d& point) {
  return DualPluckerMatrix(line) * point;
}

Eigen::Vector4d JoinPoints(const Eigen::Vector4d& a,
                           const Eigen::Vector4d& b,
                           const Eigen::Vector4d& c) {
  return JoinLinePoint(JoinPoints(a, b), c);
}

PluckerLine MeetPlanes(const Eigen::Vector4d& a, const Eigen::Vector4d& b) {
  return DualLine(JoinPoints(a, b));
}

Eigen::Vector4d MeetPlanes(const Eigen::Vector4d& a,
                           const Eigen::Vector4d& b,
                           const Eigen::Vector4d& c) {
  return MeetLinePlane(MeetPlanes(a, b), c);
}

Eigen::Vector4d MeetLinePlane(const PluckerLine& line, const Eigen::Vector4d& plane) {
  return PluckerMatrix(line) * plane;
}

double IncidenceProduct(const PluckerLine& a, const PluckerLine& b) {
  return a.head<3>().dot(b.tail<3>()) + b.head<3>().dot(a.tail<3>());
}

PluckerLine NearestLine(const PluckerLine& six) {
  // With u = d + m and v = d - m, 4 d . m = |u|^2 - |v|^2: the nearest pair keeps both directions
  // and has the mean length.
  const Eigen::Vector3d u = six.head<3>() + six.tail<3>(), v = six.head<3>() - six.tail<3>();
  const double un = u.norm(), vn = v.norm();
  const Eigen::Vector3d u_hat = un > 0.0 ? Eigen::Vector3d(u / un) : Eigen::Vector3d::UnitX();
  const Eigen::Vector3d v_hat = vn > 0.0 ? Eigen::Vector3d(v / vn) : Eigen::Vector3d::UnitX();
  const double half = 0.25 * (un + vn);
  PluckerLine line;
  line << half * (u_hat + v_hat), half * (u_hat - v_hat);
  return line;
}

double LineLineDistance(const PluckerLine& a, const PluckerLine& b) {
  const Eigen::Vector3d d1 = a.head<3>(), d2 = b.head<3>();
  const Eigen::Vector3d across = d1.cross(d2);
  if (across.norm() > kParallel * d1.norm() * d2.norm()) {
    return std::abs(IncidenceProduct(a, b)) / across.norm();
  }
  const double k = d1.dot(d2) / d1.squaredNorm();
  return d1.cross(a.tail<3>() - b.tail<3>() / k).norm() / d1.squaredNorm();
}

double PointLineDistance(const Eigen::Vector4d& point, const PluckerLine& line) {
  const Eigen::Vector3d x = point.head<3>() / point.w();
  return (line.tail<3>() - x.cross(line.head<3>())).norm() / line.head<3>().norm();
}

double PointPlaneDistance(const Eigen::Vector4d& point, const Eigen::Vector4d& plane) {
  return std::abs(plane.dot(point) / point.w()) / plane.head<3>().norm();
}

OrthonormalLine ToOrthonormal(const PluckerLine& line) {
  const Eigen::Vector3d d = line.head<3>(), m = line.tail<3>();
  const double dn = d.norm(), mn = m.norm();
  OrthonormalLine out;
  out.phi = std::atan2(mn, dn);
  // The larger of the two gives its axis exactly, the other is made perpendicular to it.
  Eigen::Vector3d u1, u2;
  if (dn >= mn) {
    u2 = dn > 0.0 ? Eigen::Vector3d(d / dn) : Eigen::Vector3d::UnitY();
    const Eigen::Vector3d rest = m - u2 * u2.dot(m);
    u1 = rest.norm() > 1e-300 ? Eigen::Vector3d(rest.normalized()) : Perpendicular(u2);
  } else {
    u1 = m / mn;
    const Eigen::Vector3d rest = d - u1 * u1.dot(d);
    u2 = rest.norm() > 1e-300 ? Eigen::Vector3d(rest.normalized()) : Perpendicular(u1);
  }
  out.U << u1, u2, u1.cross(u2);
  return out;
}

PluckerLine FromOrthonormal(const OrthonormalLine& line) {
  PluckerLine out;
  out << std::cos(line.phi) * line.U.col(1), std::sin(line.phi) * line.U.col(0);
  return out;
}

OrthonormalLine Plus(const OrthonormalLine& line, const Eigen::Vector4d& step) {
  const Eigen::Vector3d w = step.head<3>();
  const double angle = w.norm();
  OrthonormalLine out{line.U, line.phi + step(3)};
  if (angle > 0.0) out.U = line.U * Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
  return out;
}

std::array<Eigen::Vector4d, 2> PointsOnLine(const OrthonormalLine& line) {
  Eigen::Vector4d a, b;
  a << -std::sin(line.phi) * line.U.col(2), std::cos(line.phi);
  b << line.U.col(1), 0.0;
  return {a, b};
}

}  // namespace horopter
