// Images of a textured plane as the cameras of a synthetic scene see it.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

#include "tests/support/synthetic_scene.h"

namespace horopter {

// Blobs of a few sizes about grey 128, 900x900, standard deviation `contrast`.
cv::Mat PlaneTexture(int seed, double contrast);

// The textured square |x|, |y| <= 0.45 m of the plane as view v of the scene sees it, with sensor
// noise.
cv::Mat RenderPlane(const SyntheticScene& scene, int v, const cv::Mat& texture, double noise);

// Largest transfer error of points of the plane's middle, pixels.
double WorstTransfer(const SyntheticScene& scene, int a, int b, const Eigen::Matrix3d& b_from_a);

}  // namespace horopter
