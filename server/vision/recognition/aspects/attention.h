// Where an image has small things: windows for a search that looks at them enlarged. Nothing is
// asked of what they are; a window costs time, and what has none is not looked at.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/geometry/image_regions.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

struct AttentionOptions {
  // Sides (the longer ones, shares of the image's width) of what is looked for. Smaller: glints and
  // screws cost time. Larger things the whole image shows well enough.
  double least_side = 0.015, most_side = 0.16;
  int most_windows = 40;     // of an image; more: weaker things too, slower
  double margin = 0.12;      // of the longer side, about each
  double least_fill = 0.12;  // of its box, that differs from what is around it
};

struct AttentionWindow {
  ImageBox box;  // px of the image, with the margin
  // By what is expected of it, largest first: how clearly it differs from its surroundings, times
  // the enlargement that its size leaves room for.
  double gain = 0.0;
};

// Regions of one colour or shade that differ from the surroundings, and compact groups of the edges
// that the image is searched by (`searched`, of the same image; its texture and patterns have been
// taken out), largest gain first. image: 8 bit, 1 or 3 channels (BGR).
std::vector<AttentionWindow> FindWindows(const cv::Mat& image,
                                         const AspectImage& searched,
                                         const AttentionOptions& options = {});

}  // namespace horopter
