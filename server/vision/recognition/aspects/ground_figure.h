// What stands out from a textured ground, and what maps say at places on the ground.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

struct GroundFigure {
  int width = 0, height = 0;            // 0: nothing is said
  std::vector<std::uint8_t> inside;     // [cell], 1: it is not the ground
  std::vector<ImageEdgePoint> outline;  // between the two

  bool Inside(const Eigen::Vector2f& p) const {  // outside the image nothing is
    const auto x = std::lround(p.x()), y = std::lround(p.y());
    return x >= 0 && y >= 0 && x < width && y < height &&
           inside[static_cast<std::size_t>(y) * width + x] != 0;
  }
};

// map: CV_32F. Places (px) are rounded to cells, those outside to the nearest one.
inline std::vector<float> ValuesAt(const cv::Mat& map, const std::vector<Eigen::Vector2f>& places) {
  std::vector<float> values;
  values.reserve(places.size());
  for (const Eigen::Vector2f& p : places) {
    const int x = std::clamp(static_cast<int>(std::lround(p.x())), 0, map.cols - 1);
    const int y = std::clamp(static_cast<int>(std::lround(p.y())), 0, map.rows - 1);
    values.push_back(map.at<float>(y, x));
  }
  return values;
}

}  // namespace horopter
