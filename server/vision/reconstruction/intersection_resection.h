// The two linear halves of the alternation: features from cameras and cameras from features
// (thesis 3.3.1, 3.3.2).
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>

#include "server/vision/geometry/collineation.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

// An observation with what it is measured against, and its weight (>= 0; 1 counts fully).
struct WeightedPoint {
  const PointObservation* observation = nullptr;
  CameraMatrix P = CameraMatrix::Zero();        // read by the intersection
  Eigen::Vector4d X = Eigen::Vector4d::Zero();  // read by the resection
  double weight = 1.0;
};
struct WeightedLine {
  const LineObservation* observation = nullptr;
  CameraMatrix P = CameraMatrix::Zero();
  PluckerLine L = PluckerLine::Zero();
  double weight = 1.0;
};

// Smallest eigenvector of sum w a a^T, a in {u p3 - p1, v p3 - p2}. With `previous` every row is
// divided by the depth that it had there, which turns algebraic into geometric distance. Two or
// more views; rays that are one (eigenvalue ratio below 1e-14) give nullopt. |X| = 1.
std::optional<Eigen::Vector4d> IntersectPoint(std::span<const WeightedPoint> observations,
                                              const std::optional<Eigen::Vector4d>& previous = {});

// From the back-projected planes of two or more views: the two smallest right singular vectors of
// the stack span the line. With `previous` and three or more views: linear in L with the distances
// of the ends as rows, then the nearest line. Planes that are one give nullopt. |L| = 1.
std::optional<PluckerLine> IntersectLine(std::span<const WeightedLine> observations,
                                         const std::optional<PluckerLine>& previous = {});

// Camera from points (2 equations each) and lines (l^T P A = l^T P B = 0 for two points of the
// line). With `previous` rows are divided by the depths there and A, B are the points of the line
// seen at the ends of the segment, so that geometric distances are minimised. Needs 11 independent
// equations: else nullopt. |P| = 1.
std::optional<CameraMatrix> ResectCamera(std::span<const WeightedPoint> points,
                                         std::span<const WeightedLine> lines,
                                         const std::optional<CameraMatrix>& previous = {});

}  // namespace horopter
