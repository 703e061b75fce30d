// Points, planes and Plücker lines of projective 3-space: joins, meets, distances (thesis A).
#pragma once

#include <Eigen/Core>
#include <array>

namespace horopter {

// (d; m) = (L41, L42, L43, L23, L31, L12): direction, then moment. Up to scale; d . m = 0.
using PluckerLine = Eigen::Matrix<double, 6, 1>;

// [v]x with [v]x u = v x u.
Eigen::Matrix3d CrossMatrix(const Eigen::Vector3d& v);

// Lambda = A B^T - B A^T of a line through A and B, and its dual, which has d and m exchanged.
Eigen::Matrix4d PluckerMatrix(const PluckerLine& line);
Eigen::Matrix4d DualPluckerMatrix(const PluckerLine& line);

// The six-vector of a skew-symmetric matrix.
PluckerLine LineOfMatrix(const Eigen::Matrix4d& skew);

// d and m exchanged: a line given by two planes becomes one given by two points.
PluckerLine DualLine(const PluckerLine& line);

// Line through two points; zero when they coincide.
PluckerLine JoinPoints(const Eigen::Vector4d& a, const Eigen::Vector4d& b);
// Plane through three points; zero when they are collinear.
Eigen::Vector4d JoinPoints(const Eigen::Vector4d& a,
                           const Eigen::Vector4d& b,
                           const Eigen::Vector4d& c);
// Plane through a line and a point; zero when the point is on the line.
Eigen::Vector4d JoinLinePoint(const PluckerLine& line, const Eigen::Vector4d& point);
// Line in which two planes meet; zero when they are one.
PluckerLine MeetPlanes(const Eigen::Vector4d& a, const Eigen::Vector4d& b);
// Point common to three planes; zero when they share a line.
Eigen::Vector4d MeetPlanes(const Eigen::Vector4d& a,
                           const Eigen::Vector4d& b,
                           const Eigen::Vector4d& c);
// Point in which a line meets a plane; zero when the line lies in it.
Eigen::Vector4d MeetLinePlane(const PluckerLine& line, const Eigen::Vector4d& plane);

// d1 . m2 + d2 . m1; zero exactly when the lines are coplanar. Equals -det[A1 B1 A2 B2].
double IncidenceProduct(const PluckerLine& a, const PluckerLine& b);

// The line nearest to a six-vector that violates d . m = 0, in the least-squares sense (the
// optimum of Bartoli, Sturm 2005, in closed form). Keeps the scale of the input.
PluckerLine NearestLine(const PluckerLine& six);

// Euclidean distances, in the units of a metric frame. Lines must not lie at infinity, points must
// be finite: otherwise the result is not finite.
double LineLineDistance(const PluckerLine& a, const PluckerLine& b);
double PointLineDistance(const Eigen::Vector4d& point, const PluckerLine& line);
double PointPlaneDistance(const Eigen::Vector4d& point, const Eigen::Vector4d& plane);

// Orthonormal representation (Bartoli, Sturm 2005), 4 degrees of freedom: d = cos(phi) U.col(1),
// m = sin(phi) U.col(0), U a rotation. Every line has one, also at infinity (phi = pi / 2) and
// through the origin (phi = 0).
struct OrthonormalLine {
  Eigen::Matrix3d U = Eigen::Matrix3d::Identity();
  double phi = 0.0;
};

OrthonormalLine ToOrthonormal(const PluckerLine& line);
PluckerLine FromOrthonormal(const OrthonormalLine& line);

// U <- U exp([step.head<3>()]x), phi <- phi + step(3).
OrthonormalLine Plus(const OrthonormalLine& line, const Eigen::Vector4d& step);

// Two orthonormal points on the line; JoinPoints of them is FromOrthonormal.
std::array<Eigen::Vector4d, 2> PointsOnLine(const OrthonormalLine& line);

}  // namespace horopter
