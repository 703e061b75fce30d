// Where lines in space come together.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

namespace horopter {

// A line through `origin` along the unit vector `direction`.
struct SpaceLine {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
};

// The point whose squared distances to the lines have the least sum; nothing for lines that are
// parallel to `least_rad` (the sine of the widest angle with the first), or fewer than two.
std::optional<Eigen::Vector3d> NearestToLines(std::span<const SpaceLine> lines,
                                              double least_rad = 1e-6);

}  // namespace horopter
