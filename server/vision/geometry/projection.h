// Projection of points and lines by 3 x 4 cameras, and what cameras say about the scene (thesis B).
#pragma once

#include <Eigen/Core>

#include "server/vision/geometry/plucker_line.h"

namespace horopter {

using CameraMatrix = Eigen::Matrix<double, 3, 4>;
using LineCameraMatrix = Eigen::Matrix<double, 3, 6>;

// P_L with l ~ P_L L: rows L(p2, p3), L(p3, p1), L(p1, p2) of the rows of P. For P = [M | p] it is
// [ [p]x M | cof(M) ].
LineCameraMatrix LineCamera(const CameraMatrix& P);

// Pixels of a point; not finite for points of the principal plane.
Eigen::Vector2d ProjectPoint(const CameraMatrix& P, const Eigen::Vector4d& point);

// Image line l with l^T x = 0, |l.head<2>()| = 1 so that l^T (x, y, 1) is a distance in pixels. Not
// finite for a line through the camera's centre.
Eigen::Vector3d ProjectLine(const CameraMatrix& P, const PluckerLine& line);

// Plane through the camera's centre and an image line.
Eigen::Vector4d BackProjectLine(const CameraMatrix& P, const Eigen::Vector3d& line);

// Centre as the signed 4 x 4 minors: C_k = (-1)^k det(P without column k), k = 1..4, so w = det M
// (Hartley 1998). Chirality needs the sign.
Eigen::Vector4d CameraCenter(const CameraMatrix& P);

// Depth of a point up to the positive factor 1 / |M row 3|: positive in front of the camera. Only
// its sign has a meaning in a quasi-affine frame.
double SignedDepth(const CameraMatrix& P, const Eigen::Vector4d& point);

// H with P H = [I | 0]. P must have rank 3.
Eigen::Matrix4d CanonicalFrame(const CameraMatrix& P);

}  // namespace horopter
