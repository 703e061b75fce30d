// The motion between two calibrated views from points of which some are matched wrongly.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "server/vision/geometry/rigid3.h"
#include "server/vision/matching/homography.h"

namespace horopter {

// points: normalised (principal point 0, focal length 1). The five-point method (Nister 2004) in
// RANSAC, with the points in front of both cameras; holds of planar scenes too. b_from_a with
// |t| = 1. gate: Sampson distance of an inlier in the same unit. Nullopt for fewer than 8 points or
// where fewer agree.
std::optional<Rigid3> EstimateRelativePose(std::span<const PointPair> points, double gate);

}  // namespace horopter
