// Polygons in space -> triangles.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace horopter {

// Polygons of more corners that are not convex are not cut: clipping ears takes the square of them.
inline constexpr int kMaxConcaveCorners = 5000;

// Cuts a plane polygon, convex or not, into triangles: a fan where it is convex, else by clipping
// ears; fewer than three corners, or more than kMaxConcaveCorners that are not convex, give
// nothing, a polygon that crosses itself gives some triangles. All indices are within `points`.
std::vector<Eigen::Vector3i> TriangulatePolygon(const std::vector<Eigen::Vector3d>& points,
                                                std::vector<int> polygon);

}  // namespace horopter
