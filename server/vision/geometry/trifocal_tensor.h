// Three-view geometry: l1_i = l2^T T_i l3 (thesis B.4).
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>

#include "server/vision/geometry/projection.h"

namespace horopter {

// T[i] is 3 x 3, rows of the second, columns of the third view; up to a common scale. For
// P1 = [I | 0], P2 = [A | a4], P3 = [B | b4]: T_i = a_i b4^T - a4 b_i^T.
using TrifocalTensor = std::array<Eigen::Matrix3d, 3>;

// From any three cameras (4 x 4 determinants of their rows), |T| = 1.
TrifocalTensor TrifocalFromCameras(const CameraMatrix& P1,
                                   const CameraMatrix& P2,
                                   const CameraMatrix& P3);

// Cameras with P1 = [I | 0] (Hartley, Zisserman 15.1); nullopt when the epipoles are not
// determined.
std::optional<std::array<CameraMatrix, 3>> CamerasFromTrifocal(const TrifocalTensor& T);

// Line of the first view from lines of the other two.
Eigen::Vector3d TransferLine(const TrifocalTensor& T,
                             const Eigen::Vector3d& l2,
                             const Eigen::Vector3d& l3);

// Point of the third view from a point of the first and a line through its image in the second.
Eigen::Vector3d TransferPoint(const TrifocalTensor& T,
                              const Eigen::Vector3d& x1,
                              const Eigen::Vector3d& l2);

// One scene point or line in three views; points homogeneous pixels, lines l^T x = 0.
using Triplet = std::array<Eigen::Vector3d, 3>;

// Linear estimate from points (4 independent equations each) and lines (2 each), at least 26
// equations, then again under the constraint that the epipoles impose (Hartley, Zisserman algorithm
// 16.2), so that the result is the tensor of three cameras. Coordinates are normalised inside.
// Too few or degenerate: nullopt.
std::optional<TrifocalTensor> EstimateTrifocal(std::span<const Triplet> points,
                                               std::span<const Triplet> lines);

}  // namespace horopter
