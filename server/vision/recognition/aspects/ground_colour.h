// What stands out by its colour from a textured ground, as granite is: its grains differ in
// brightness, hardly in colour.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

struct ColourFigure {
  int width = 0, height = 0;
  std::vector<std::uint8_t> differs;    // [cell], 1: of another colour than the ground
  std::vector<ImageEdgePoint> outline;  // between the two, one point a cell

  bool Differs(const Eigen::Vector2f& p) const;  // outside the image nothing does
};

// bgr: 8 bit, three channels. `ground`: places on the ground, px; the colour of most of them is its
// colour, its scatter what does not count. Empty (width 0) with fewer than 200 places or where they
// have no common colour.
ColourFigure FindColourFigure(const cv::Mat& bgr,
                              const std::vector<Eigen::Vector2f>& ground,
                              const AspectImageOptions& options);

}  // namespace horopter
