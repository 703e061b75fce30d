// The part of an image in which objects are looked for, and how large it is looked at.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/geometry/image_regions.h"

namespace horopter {

struct SearchedPart {
  std::vector<ImageBox> boxes;  // px of the image, within it; empty: nothing of it is searched
  // The same image in other pixels, from which it was made; empty: there are none.
  cv::Mat pixels;
  double pixels_from_image = 1.0;  // u_pixels = (u + 0.5) * this - 0.5
  double most_enlarged = 3.0;      // WorkingCutOptions::most_enlarged
};

// A cut-out that holds all boxes, of SearchedPart::pixels or the image, and its enlargement.
struct WorkingCut {
  cv::Rect cut;        // pixels of what is cut
  double scale = 1.0;  // working pixels per pixel of what is cut
};

struct WorkingCutOptions {
  // The longer side of the smallest box gets so many working pixels where that needs no more than
  // `most_enlarged` of them per pixel: a part that it holds with some margin then has the 100 - 200
  // at which single images list nearly all (ADR 61). Larger: smaller parts are found, slower.
  double box_px = 240.0;
  double most_enlarged = 3.0;
  double least_scale = 0.0;          // ... and at least this scale, that of the whole image
  double most_px = 2560.0 * 1920.0;  // working pixels of a cut-out at most
  int margin_px = 16;                // working pixels about the boxes, as smoothing looks there
};

// Of one of so many images: their cut-outs share what four of the largest take.
WorkingCutOptions CuttingOf(int images);

// size: of what is cut; boxes: in its pixels, not empty, each with something of it.
WorkingCut CutOf(const cv::Size& size,
                 const std::vector<ImageBox>& boxes,
                 const WorkingCutOptions& options);

}  // namespace horopter
