// Direct least-squares fit of an ellipse (Fitzgibbon et al. 1999 in the stable form of Halir and
// Flusser 1998).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "server/vision/features/features.h"

namespace horopter {

// Coefficients of a x^2 + b xy + c y^2 + d x + e y + f = 0 in this order.
using ConicCoefficients = Eigen::Matrix<double, 6, 1>;

// The ellipse of least algebraic error from the scatter matrix (sum of m m^T over the points, m =
// (x^2, xy, y^2, x, y, 1)); 4 a c - b^2 = 1. Coordinates should be centred and of size about 1. The
// eigenproblem M v = lambda C v of the reduced scatter has, M being positive, exactly one positive
// root; its cubic is solved in closed form. Empty when the points leave no ellipse: collinear or
// too few.
std::optional<ConicCoefficients> EllipseFromScatter(const Eigen::Matrix<double, 6, 6>& scatter);

// Centre, semi-axes and angle (start, sweep and rms are left 0). Empty when the conic is no real
// ellipse.
std::optional<EllipseArc> EllipseFromConic(const ConicCoefficients& conic);

// Fits an ellipse to at least 6 points (pixels). rms_px is of the first-order (Sampson) distances;
// start and sweep span the points, which must follow each other along the arc for the sweep to mean
// anything (SpanOf finds it for unordered ones). Empty for collinear or too few points.
std::optional<EllipseArc> FitEllipse(std::span<const Eigen::Vector2f> points);

// The same without start and sweep, in half of the time.
std::optional<EllipseArc> FitWholeEllipse(std::span<const Eigen::Vector2f> points);

// First-order distance of a point from the whole ellipse, pixels.
double EllipseDistance(const EllipseArc& ellipse, const Eigen::Vector2d& point);

// The point of the ellipse nearest to `point`, both in pixels.
Eigen::Vector2d NearestOnEllipse(const EllipseArc& ellipse, const Eigen::Vector2d& point);

// Sets start_rad and sweep_rad to what points that follow each other along the arc span.
void SpanInOrder(std::span<const Eigen::Vector2f> points, EllipseArc* arc);

// Sets start_rad and sweep_rad to the complement of the largest angular gap between the points and
// returns the share of the sweep that lies within 10 degrees of a point.
double SpanOf(std::span<const Eigen::Vector2f> points, EllipseArc* arc);

}  // namespace horopter
