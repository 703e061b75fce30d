// How differently two things look from one side.
#pragma once

#include <Eigen/Core>

namespace horopter {

struct ViewDifference {
  Eigen::Vector3d toward_camera = Eigen::Vector3d::UnitZ();  // unit, from the object, its frame
  // Length of edge that only one of the two shows there, pixels where a diameter is 160 px.
  double differing_px = 0.0;
};

}  // namespace horopter
