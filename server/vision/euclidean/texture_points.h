// Points of texture that were matched before any part was known, as the metric adjustment sees
// them: they hold the cameras where the parts, in the middle of the images, leave them open.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/euclidean/edge_observations.h"
#include "server/vision/euclidean/view_jacobian.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

struct TexturePoint {
  struct Sight {
    int view = -1;
    Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  };
  Eigen::Vector3d point_in_scene = Eigen::Vector3d::Zero();
  std::vector<Sight> seen;  // in two views and more, each once
};

struct ObservedTexture {
  std::vector<TexturePoint> points;  // empty: texture plays no part
  // Of one coordinate of a sight; larger than their scatter, as what a lens does beyond k1 and what
  // is matched along an edge err in common.
  double sigma_px = 1.0;
  double cauchy_sigmas = 2.0;  // residuals beyond it count ever less
};

struct TexturePointOptions {
  int max_points = 300;   // more: slower, hardly better. 0: texture plays no part
  int max_sights = 8;     // of a point
  double sigma_px = 1.0;  // ObservedTexture::sigma_px
};

// Of a reconstruction from texture the points that most known views see, spread over the images; in
// the scene of `views`. Those that the views show from one direction are left out.
ObservedTexture ChooseTexturePoints(const Reconstruction& reconstruction,
                                    std::span<const std::optional<CalibratedCamera>> views,
                                    const TexturePointOptions& options);

// One point's residuals (two a sight, in sigmas times `slack`) and their derivatives by the
// parameters of the views that see it, ten columns each, weighted by the roots of `weight`
// (Cauchy). The point itself is eliminated: to first order it follows the cameras.
struct TextureRows {
  std::vector<int> views;
  Eigen::VectorXd residual, weight;
  Eigen::MatrixXd J;
};

// False where the point is behind a camera.
bool LinearizeTexturePoint(std::span<const AdjustedView> views,
                           const ObservedTexture& texture,
                           const TexturePoint& point,
                           double slack,
                           TextureRows* rows);

// Robust cost of all points.
double TextureCost(std::span<const AdjustedView> views,
                   const ObservedTexture& texture,
                   double slack);

// Moves each point to where its sights agree best under the cameras as they are now.
void FollowCameras(std::span<const AdjustedView> views, double slack, ObservedTexture* texture);

// Median distance of the sights from their points, in sigmas; 0 without points.
double TextureDeviation(std::span<const AdjustedView> views, const ObservedTexture& texture);

}  // namespace horopter
