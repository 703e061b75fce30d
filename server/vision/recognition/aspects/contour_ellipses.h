// Ellipses among the contours of an image.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

struct ContourEllipseOptions {
  int most = 24;  // largest first
};

// Ellipses of single chains of the contours, working pixels; those that coincide are one.
std::vector<EllipseArc> FindContourEllipses(const ContourGraph& contours,
                                            const ContourEllipseOptions& options = {});

}  // namespace horopter
