// What stands alone in an image: regions that edges enclose, and ellipses among the contours.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

struct ClosedOutlineOptions {
  int gap_px = 2;               // edges this near are closed; larger: broken outlines, fewer apart
  double min_size_px = 20.0;    // shorter side of the bounding box
  double max_size_share = 0.9;  // of the image's width: ... longer side
  int most = 12;                // largest first
};

// Hulls of the regions that cannot be reached from the image's border without crossing an edge,
// working pixels; largest area first.
std::vector<std::vector<Eigen::Vector2f>> FindClosedOutlines(
    const AspectImage& image, const ClosedOutlineOptions& options = {});

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
