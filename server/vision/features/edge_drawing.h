// Edge chains and raw line pieces of one channel by EdgeDrawing (Topal & Akinlar 2012; EDLines
// 2011).
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

struct RawLine {
  Eigen::Vector2d start = Eigen::Vector2d::Zero();
  Eigen::Vector2d end = Eigen::Vector2d::Zero();
};

struct DrawnEdges {
  std::vector<std::vector<cv::Point>> chains;  // neighbouring pixels follow each other
  std::vector<RawLine> lines;                  // validated by the number of false alarms
};

// grey: CV_8UC1. One detector object per call: OpenCV's is not safe to share between threads.
// `gradient_threshold` replaces the one of the options; the anchor threshold scales with it.
DrawnEdges DrawEdges(const cv::Mat& grey, double gradient_threshold, const FeatureOptions& options);

}  // namespace horopter
