// Where a further image would have to be taken from to tell an answered object from what else may
// stand there.
#pragma once

#include <optional>
#include <span>

#include "server/vision/euclidean/euclidean.h"
#include "server/vision/geometry/view_difference.h"

namespace horopter {

struct DecidingView {
  Rigid3 scene_from_camera;  // x right, y down, z forward, through the object's middle
  double differing_px = 0.0;
};

// Of the directions the one from which the two differ most, of those from above the plane that the
// scene stands on, where it has one; at the distance of the middle one of the cameras.
// object_middle: object frame. Nothing where they differ nowhere, or no camera is known.
std::optional<DecidingView> FindDecidingView(std::span<const ViewDifference> views,
                                             const Rigid3& scene_from_object,
                                             const Eigen::Vector3d& object_middle,
                                             const MetricScene& scene);

}  // namespace horopter
