// Circles among the edges of a part.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// Object frame, metres; the axis has unit length and either sense.
struct ModelCircle {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();
  double radius_m = 0.0;
  int edge = -1;  // index into ObjectModel::edges
};

// The circles and circular arcs among the edges.
std::vector<ModelCircle> CirclesOf(const ObjectModel& model);

// Those that are closed and whose radius is at least so large a share of the diameter, largest
// first, of (nearly) equal ones the first; at most `most`.
std::vector<ModelCircle> LargeRims(const ObjectModel& model, double least_share, int most);

}  // namespace horopter
