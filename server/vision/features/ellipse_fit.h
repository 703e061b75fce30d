// Direct least-squares fit of an ellipse (Fitzgibbon et al. 1999 in the stable form of Halir and
// Flusser 1998).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "server/vision/features/features.h"

namespace horopter {

// Fits an ellipse to at least 6 points (pixels). rms_px is of the first-order (Sampson) distances;
// start and sweep span the points, which must follow each other along the arc for the sweep to mean
// anything (SpanOf finds it for unordered ones). Empty for collinear or too few points.
std::optional<EllipseArc> FitEllipse(std::span<const Eigen::Vector2f> points);

// First-order distance of a point from the whole ellipse, pixels.
double EllipseDistance(const EllipseArc& ellipse, const Eigen::Vector2d& point);

// Sets start_rad and sweep_rad to the complement of the largest angular gap between the points and
// returns the share of the sweep that lies within 10 degrees of a point.
double SpanOf(std::span<const Eigen::Vector2f> points, EllipseArc* arc);

}  // namespace horopter
