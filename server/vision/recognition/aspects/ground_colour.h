// What stands out by its colour from a textured ground, as granite is: its grains differ in
// brightness, hardly in colour.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/ground_figure.h"

namespace horopter {

// bgr: 8 bit, three channels. `ground`: places on the ground, px; the colour of most of them is its
// colour, its scatter what does not count. Empty (width 0) with fewer than 200 places or where they
// have no common colour.
GroundFigure FindColourFigure(const cv::Mat& bgr,
                              const std::vector<Eigen::Vector2f>& ground,
                              const AspectImageOptions& options);

}  // namespace horopter
