// Ellipses among the contours of an image.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

struct ContourEllipseOptions {
  double min_minor_px = 4.0;   // semi-axis
  double min_sweep_rad = 2.0;  // of the arc that is seen: sides of a cylinder cut its rim in two
  double max_rms_px = 0.5;     // of its points
  int most = 24;               // largest first
};

// Ellipses of single chains of the contours, working pixels; those that coincide are one.
std::vector<EllipseArc> FindContourEllipses(const ContourGraph& contours,
                                            const ContourEllipseOptions& options = {});

}  // namespace horopter
