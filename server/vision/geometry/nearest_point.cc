#include "server/vision/geometry/nearest_point.h"

#include <Eigen/Dense>
#include <algorithm>

namespace horopter {

// Sum of (I - d d') (x - c) = 0.
std::optional<Eigen::Vector3d> NearestToLines(std::span<const SpaceLine> lines, double least_rad) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  double widest = 0.0;
  for (const SpaceLine& line : lines) {
    const Eigen::Matrix3d off =
        Eigen::Matrix3d::Identity() - line.direction * line.direction.transpose();
    A += off;
    b += off * line.origin;
    widest = std::max(widest, line.direction.cross(lines.front().direction).norm());
  }
  if (!(widest >= least_rad)) return std::nullopt;
  return A.ldlt().solve(b);
}

}  // namespace horopter
