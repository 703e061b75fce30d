// How supporting planes, epipolar geometries and cameras of matching and reconstruction compare
// with what is true of a scene.
#pragma once

#include <Eigen/Core>
#include <utility>

#include "server/vision/reconstruction/reconstruction.h"
#include "tests/diagnose/true_world.h"

namespace horopter {

// Median and 90 % transfer error, pixels, over points of the table (z = 0 of the world that the
// file gives) seen in both views; negative: none.
std::pair<double, double> PlaneError(const BopImage& a,
                                     const BopImage& b,
                                     const Eigen::Matrix3d& b_from_a);

// Share of the annotated parts' vertices (inside both images, hidden ones too) within 2 px of F,
// and the 95 % distance, pixels; 0 and negative: none.
std::pair<double, double> FundamentalQuality(const TrueModels& models,
                                             const BopImage& a,
                                             const BopImage& b,
                                             const Eigen::Matrix3d& F);

// 95 % over the annotated parts' vertices of the worst reprojection after triangulating the vertex
// from its true images: zero for the true cameras and for any collineation of them. Negative: fewer
// than two views. Pixels.
double VertexReprojection(const TrueModels& models,
                          const BopScene& scene,
                          const Reconstruction& reconstruction);

}  // namespace horopter
