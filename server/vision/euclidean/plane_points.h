// The supporting plane's matched points in the metric frame: the best calibration object in the
// scene.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/recognition/types.h"

namespace horopter {

struct PlanePoints {
  struct Match {
    int view_a = -1;
    int view_b = -1;
    Eigen::Vector2d pixel_a = Eigen::Vector2d::Zero();
    Eigen::Vector2d pixel_b = Eigen::Vector2d::Zero();
  };
  // Plane plane.(X - anchor) = -1 in the scene frame; the anchor is the mean camera centre.
  Eigen::Vector3d plane = Eigen::Vector3d::Zero();
  Eigen::Vector3d anchor = Eigen::Vector3d::Zero();
  std::vector<Match> matches;
};

// Where view b sees the plane's point that view a sees at m.pixel_a, minus m.pixel_b; empty when
// there is no such point before both cameras.
std::optional<Eigen::Vector2d> PlaneTransferError(const CalibratedCamera& a,
                                                  const CalibratedCamera& b,
                                                  const PlanePoints& points,
                                                  const PlanePoints::Match& m);

// Triangulates the plane matches between known cameras, fits a plane (RANSAC, fixed seed) and keeps
// at most 60 matches per pair that agree with it within 12 px. No matches when fewer than 12 agree:
// the plane then plays no part.
PlanePoints FindPlanePoints(const MatchingResult& matching,
                            const std::vector<std::optional<CalibratedCamera>>& views);

}  // namespace horopter
