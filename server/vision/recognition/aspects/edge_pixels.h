// Edge points of a colour image by largest gradient, non-maximum suppression and hysteresis.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// Thinned edge points, at most one a cell, in raster order. bgr: 8 bit, three channels.
std::vector<ImageEdgePoint> DetectEdgePoints(const cv::Mat& bgr, const AspectImageOptions& options);

// Fills chain_points and chains from edges and edge_at: runs of 8-connected edge points, split where
// another chain ends on them, their ends linked over gaps of at most max_gap_px.
void LinkContours(const AspectImageOptions& options, AspectImage* image);

}  // namespace horopter
