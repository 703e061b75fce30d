// Collineations of projective 3-space on points, planes and lines, and their estimation from
// corresponding points and lines (thesis A, 4.4).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "server/vision/geometry/matrix6.h"
#include "server/vision/geometry/plucker_line.h"

namespace horopter {

// X' ~ H X, pi' ~ H^-T pi, Lambda' = H Lambda H^T.
Eigen::Vector4d MapPoint(const Eigen::Matrix4d& H, const Eigen::Vector4d& point);
Eigen::Vector4d MapPlane(const Eigen::Matrix4d& H, const Eigen::Vector4d& plane);
PluckerLine MapLine(const Eigen::Matrix4d& H, const PluckerLine& line);

// The 6 x 6 matrix of MapLine: columns are the images of the six coordinate lines.
Matrix6d LineCollineation(const Eigen::Matrix4d& H);

struct PointPair3 {
  Eigen::Vector4d from = Eigen::Vector4d::Zero();
  Eigen::Vector4d to = Eigen::Vector4d::Zero();
};
struct LinePair3 {
  PluckerLine from = PluckerLine::Zero();
  PluckerLine to = PluckerLine::Zero();
};

// Linear, scale-free: X' ^ H X = 0 for points and Lambda'* H Lambda = 0 for lines, rows at unit
// norm. Needs 5 points in general position, 3 points and 2 lines, or 5 lines; fewer or a degenerate
// set (the second smallest singular value below 1e-9 of the largest) gives nullopt. Coordinates
// should be of order 1. |H| = 1.
std::optional<Eigen::Matrix4d> FitCollineation(std::span<const PointPair3> points,
                                               std::span<const LinePair3> lines);

// Minimises sum |x' - H x|^2 over finite target points, 15 parameters, Levenberg-Marquardt from H.
// Returns H unchanged when it cannot be improved.
Eigen::Matrix4d RefineCollineation(const Eigen::Matrix4d& H, std::span<const PointPair3> points);

// Root mean square of |x' - H x| over the pairs, in units of the target frame; not finite when a
// point goes to infinity.
double CollineationRms(const Eigen::Matrix4d& H, std::span<const PointPair3> points);

}  // namespace horopter
