// Where the cameras of several views stand relative to a plane that all of them see (plane +
// parallax over many views; Rother and Carlsson 2001, Triggs 2000).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/matching/matching_options.h"

namespace horopter {

// With the plane's homographies known, P_i = [H_i | e_i] and a point is (x, y, 1, rho): rho = 0 on
// the plane. What is left of each camera is e_i, three numbers; a third view needs two points only,
// and one camera's numbers are one linear system.
struct PlaneView {
  Eigen::Matrix3d view_from_plane = Eigen::Matrix3d::Identity();  // pixels
};
struct PlanePoint {
  struct Observation {
    int view = -1;
    Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  };
  std::vector<Observation> observations;  // at most one per view; tentative
};

struct PlaneCentres {
  // e_i in pixels of view i; empty: not determined. Common scale and one view's offset are free:
  // the first determined view has e = 0.
  std::vector<std::optional<Eigen::Vector3d>> epipoles;
  struct Pair {
    int view_a = -1, view_b = -1;
    Eigen::Matrix3d F = Eigen::Matrix3d::Zero();  // x_b^T F x_a = 0, pixels, unit norm
    double sigma_px = 0.0;  // largest predicted deviation of an epipolar line at a point
  };
  std::vector<Pair> pairs;       // of determined views, sigma_px within bounds
  std::vector<bool> point_used;  // per point: off the plane and consistent in >= 2 views
  double rms_px = 0.0;
};

// Robust: pairs of views in turn are the start (epipole from two points), other views are added
// where most points agree, then cameras and points are refined together with Cauchy weights.
// Deterministic for a seed. Fewer than two views or too few points give an empty result.
PlaneCentres EstimatePlaneCentres(std::span<const PlaneView> views,
                                  std::span<const PlanePoint> points,
                                  const PlaneCentresOptions& options);

}  // namespace horopter
