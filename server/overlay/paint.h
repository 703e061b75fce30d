// A drawing on the pixels of an image.
#pragma once

#include <span>

#include "server/overlay/drawing.h"

namespace cv {
class Mat;
}

namespace horopter {

// A BGR copy of an 8-bit grey or BGR image, to be painted on.
cv::Mat Canvas(const cv::Mat& image);

// image: 8-bit BGR of the drawing's size.
void Paint(const Drawing& drawing, cv::Mat* image);

// Tiles BGR images row by row; each is scaled down to at most `tile_width` pixels.
cv::Mat Tile(std::span<const cv::Mat> images, int tile_width);

}  // namespace horopter
