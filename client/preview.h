// Pictures of an enrolled object: what the server knows of it, so that a bad import is seen at
// once.
#pragma once

#include <opencv2/core/mat.hpp>

#include "server/vision/geometry/object_model.h"

namespace horopter {

struct PreviewOptions {
  int tile_px = 360;
  int columns = 4;      // views around the part, in each of two rows
  int max_grasps = 40;  // more would hide the part
};

// BGR. Two rows of views around the part, from above and from below, with the enrolled edges over
// the shaded mesh, symmetry axes (with their order) and grasps as grippers; below them the most
// probable stable poses on the table with their shares. The part's frame stands at its origin: x
// red, y green, z blue.
cv::Mat RenderPreview(const ObjectModel& model, const PreviewOptions& options = {});

}  // namespace horopter
