// What stands out from a textured ground, as granite is, because it has no grain: smooth parts of
// any colour. Shadows have the ground's grain.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/ground_figure.h"

namespace horopter {

// bgr: 8 bit, three channels. `ground`: places on the ground, px; the grain of most of them is its
// grain. Grain is the ratio of what is bright to what is dark within some px, which light and shade
// leave as it is. Empty (width 0) where the places are less than 2 % of the image or have no grain.
GroundFigure FindSmoothFigure(const cv::Mat& bgr,
                              const std::vector<Eigen::Vector2f>& ground,
                              const AspectImageOptions& options);

}  // namespace horopter
