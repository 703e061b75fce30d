// Sharpened images overshoot on both sides of an edge and come back: the way back is no edge.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// By what share of an edge's step the image overshoots on the side where it does so less, median
// over its strong edges between even sides; some .0 of images as lenses make them. Where there are
// few strong edges, 0. bgr: 8 bit, three channels; edges: of it.
double Overshoot(const cv::Mat& bgr, const std::vector<ImageEdgePoint>& edges);

// Takes out edges that are the way back from the overshoot of a stronger one beside them; none of
// images that do not overshoot.
void DropHalos(const cv::Mat& bgr, std::vector<ImageEdgePoint>* edges);

}  // namespace horopter
