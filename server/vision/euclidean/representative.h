// Which of the equivalent poses of a symmetric object is answered.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// Axis of a surface of revolution (object frame, unit), through `point`; empty when the symmetries
// list fewer than kRevolutionSteps rotations about one axis.
struct RevolutionAxis {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
};
inline constexpr int kRevolutionSteps = 17;  // rotations about an axis of revolution
std::optional<RevolutionAxis> FindRevolutionAxis(const ObjectModel& model);

// Among camera_from_object * S over the symmetries S (any angle about an axis of revolution), the
// one nearest to a fixed direction in which nothing is aligned with the axes of parts or cameras.
// The same images so give the same representative. Poses half-way between two can flip: any choice
// by the pose alone has such poses.
Rigid3 RepresentativePose(const ObjectModel& model, const Rigid3& camera_from_object);

}  // namespace horopter
