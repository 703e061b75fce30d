// What maps say at places on the ground.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace horopter {

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
