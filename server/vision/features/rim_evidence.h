// What the gradient fields say along an ellipse: where across the curve the gradient peaks, and how
// strongly. Finds the faint rest of a rim of which only a part was linked.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/features.h"

namespace horopter {

// Of one place on the ellipse; places follow each other at about 1 px.
struct RimPoint {
  double angle_rad = 0.0;  // parameter s of EllipseArc
  double offset_px = 0.0;  // of the gradient's peak from the ellipse, outwards
  double strength = 0.0;   // of the peak, in thresholds of its channel; 0 outside the image
  Eigen::Vector2f peak = Eigen::Vector2f::Zero();
};

// Gradients across the ellipse, averaged over 5 neighbouring places (noise falls, an edge that
// follows the curve stays) and searched within reach_px on both sides; the strongest field counts.
// Pieces of texture that cross the curve do not add up.
std::vector<RimPoint> MeasureRim(const EllipseArc& ellipse,
                                 std::span<const GradientField> fields,
                                 double reach_px);

// The ellipse fitted to its own rim, with start and sweep of what is seen of it and the share of
// that sweep that is seen.
struct FittedRim {
  EllipseArc arc;
  double seen_share = 0.0;
  double score = 0.0;  // places seen, each the less the weaker and farther off, minus unseen ones
};

// Empty when too little is seen or it fits no ellipse.
std::optional<FittedRim> FitRim(const EllipseArc& seed,
                                std::span<const GradientField> fields,
                                const RimOptions& options);

}  // namespace horopter
