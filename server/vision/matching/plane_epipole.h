// One view's epipole e of [H | e], H of the plane known, from points off the plane.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <random>
#include <span>

#include "server/vision/matching/plane_bundle.h"

namespace horopter {

// Of inlier_px, of a point that others have fixed: it errs as well.
inline constexpr double kOthersSlack = 1.5;

struct PlaneEpipoleOptions {
  double inlier_px = 2.0;
  int hypotheses = 300;  // samples of two points
};

// Two images of a point: where the plane takes it from the first view to the second, and where the
// second sees it. Working coordinates, third entry 1.
struct PlaneParallax {
  Eigen::Vector3d y = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d p = Eigen::Vector3d::UnitZ();
};

// The epipole in the second view that most points move along a line with, all to one side: rho > 0
// towards the cameras. Robust (samples of two points); empty with fewer than three points.
std::optional<Eigen::Vector3d> EpipoleFromParallax(std::span<const PlaneParallax> points,
                                                   const PlaneEpipoleOptions& options,
                                                   std::mt19937* rng);

// A point of the scene and where the view sees it.
struct PlaneResectionSight {
  Eigen::Vector4d X = Eigen::Vector4d::Zero();
  Eigen::Vector3d p = Eigen::Vector3d::UnitZ();
};
struct PlaneResection {
  Eigen::Vector3d e = Eigen::Vector3d::Zero();
  size_t inliers = 0;  // within 1.5 inlier_px
};

// The view's e from points that others have fixed: one linear system, rho [p]x e = -[p]x H x.
// Robust (samples of two points, then all that agree).
PlaneResection EpipoleFromPoints(const Eigen::Matrix3d& H,
                                 std::span<const PlaneResectionSight> sights,
                                 const PlaneEpipoleOptions& options,
                                 std::mt19937* rng);

}  // namespace horopter
