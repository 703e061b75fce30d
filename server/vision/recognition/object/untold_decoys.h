// Parts like an enrolled one that images of a usual size do not tell from it.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// See UntoldDecoy in catalog.proto.
struct UntoldDecoy {
  enum class Kind { kMirrorImage, kFeature };
  Kind kind = Kind::kMirrorImage;
  Eigen::Vector3d feature_place = Eigen::Vector3d::Zero();  // object frame, metres
  double feature_size_m = 0.0;
  double differing_px = 0.0;  // in the view, of 26 around, that tells most; a diameter is 160 px
};

// Of the part's mirror image and of its features those that differ by less than `least_px` in every
// view, largest first; none of a part without a surface. Some hundred milliseconds.
std::vector<UntoldDecoy> FindUntoldDecoys(const ObjectModel& model, double least_px = 16.0);

}  // namespace horopter
