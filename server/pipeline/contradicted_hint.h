// What is told of a lens whose hint the images contradict.
#pragma once

#include <Eigen/Core>

#include "server/pipeline/scene.h"

namespace horopter {

// What the image alone says: pixels.
ContradictedHint TellHint(int image, double focal_px, const Eigen::Vector2d& principal_point);

}  // namespace horopter
