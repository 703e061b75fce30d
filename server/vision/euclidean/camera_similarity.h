// Views taken by one camera, or by cameras of one kind: what one view says of its focal length,
// principal point and lens then holds for the others too.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/euclidean/edge_observations.h"

namespace horopter {

// Views whose cameras are alike: each parameter is drawn to the views' mean with this deviation.
// 0: not at all.
struct CameraSimilarity {
  std::vector<int> views;  // known ones, two at least
  double log_focal_sigma = 0.0;
  double center_sigma_px = 0.0;
  double k1_sigma = 0.0;
};

// Sum of the squared distances from the means, in sigmas.
double SimilarityCost(std::span<const AdjustedView> views, std::span<const CameraSimilarity> alike);

// Adds the same to normal equations A x = -b; at[v]: first of the four parameters log f, cx, cy, k1
// of view v. b may be null.
void AddSimilarity(std::span<const AdjustedView> views,
                   std::span<const CameraSimilarity> alike,
                   std::span<const int> at,
                   Eigen::MatrixXd* A,
                   Eigen::VectorXd* b);

}  // namespace horopter
