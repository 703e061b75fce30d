// Planes among reconstructed points: what things stand on, walls, boards, sheets.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/reconstruction_options.h"

namespace horopter {

// {x : normal . x = offset} in the points' frame, |normal| = 1.
struct PointPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset = 0.0;
  std::vector<int> points;  // indices of those within the tolerance
};

// The planes of most points, one after the other (RANSAC, then least squares), largest first.
// tolerance: in the points' unit. Deterministic for options.seed.
std::vector<PointPlane> FindPointPlanes(std::span<const Eigen::Vector3d> points,
                                        double tolerance,
                                        const PointPlaneOptions& options);

// Of the planes the first with all cameras on one side and nearly all points on it or on that side;
// turned so that its normal points there. -1: none.
int SupportingPlaneOf(std::span<const Eigen::Vector3d> points,
                      std::span<const std::optional<CalibratedView>> views,
                      double tolerance,
                      const PointPlaneOptions& options,
                      std::vector<PointPlane>* planes);

}  // namespace horopter
