#include "server/vision/features/edge_drawing.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/ximgproc/edge_drawing.hpp>

namespace horopter {

DrawnEdges DrawEdges(const cv::Mat& grey,
                     double gradient_threshold,
                     const FeatureOptions& options) {
  const cv::Ptr<cv::ximgproc::EdgeDrawing> detector = cv::ximgproc::createEdgeDrawing();
  cv::ximgproc::EdgeDrawing::Params params;
  params.GradientThresholdValue = static_cast<int>(std::lround(gradient_threshold));
  params.AnchorThresholdValue =
      std::max(1,
               static_cast<int>(std::lround(options.anchor_threshold * gradient_threshold /
                                            options.gradient_threshold)));
  params.Sigma = static_cast<float>(options.smoothing_sigma_px);
  params.MinPathLength = 10;
  params.MinLineLength = static_cast<int>(std::lround(options.min_segment_length_px));
  params.NFAValidation = true;
  detector->setParams(params);
  detector->detectEdges(grey);
  DrawnEdges edges;
  edges.chains = detector->getSegments();
  if (edges.chains.empty()) {
    return edges;  // detectLines is not defined for an image without edges
  }
  std::vector<cv::Vec4f> lines;
  detector->detectLines(lines);
  edges.lines.reserve(lines.size());
  for (const cv::Vec4f& line : lines) {
    const RawLine raw = {{line[0], line[1]}, {line[2], line[3]}};
    if (raw.start.allFinite() && raw.end.allFinite() &&
        (raw.end - raw.start).norm() >= options.min_segment_length_px) {
      edges.lines.push_back(raw);
    }
  }
  return edges;
}

}  // namespace horopter
