// The edge points of one image with the directions of their edges.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Thresholds of the adjustment are in working pixels: of the image scaled so that its width is at
// most this.
inline constexpr int kAdjustmentWidth = 640;  // px

// An edge point with the direction of its edge (radians, modulo pi), pixels of the original image.
struct EdgePoint {
  Eigen::Vector2f point = Eigen::Vector2f::Zero();
  float direction = 0.0f;
};

// The edge points of an image's segments and chains, about one per pixel of length.
std::vector<EdgePoint> CollectEdgePoints(const ImageFeatures& features);

}  // namespace horopter
