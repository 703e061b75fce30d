// Edge points of a colour image by largest gradient, non-maximum suppression and hysteresis.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// Thinned edge points, at most one a cell, in raster order. bgr: 8 bit, three channels.
std::vector<ImageEdgePoint> DetectEdgePoints(const cv::Mat& bgr, const AspectImageOptions& options);

}  // namespace horopter
