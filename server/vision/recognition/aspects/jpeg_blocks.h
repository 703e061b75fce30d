// The 8 x 8 blocks of JPEG: steps along their grid that quantisation makes are no edges.
#pragma once

#include <opencv2/core/mat.hpp>

namespace horopter {

// By how much steps between neighbouring pixels are larger across the grid's lines than beside
// them, grey levels (mean over places without strong edges, of both directions the larger). Around
// 0 of images without blocks, as of any that were scaled, turned or cut out off the grid
// afterwards. image: 8 bit, 1 or 3 channels.
double Blockiness(const cv::Mat& image);

struct Unblocked {
  cv::Mat image;
  double blockiness = 0.0;  // before; 0: it has no blocks
};

// The image with the steps across its grid spread over four pixels, where both sides are flat and
// the step is one that its quantisation explains; itself where it has no blocks.
Unblocked WithoutBlocks(const cv::Mat& image);

}  // namespace horopter
