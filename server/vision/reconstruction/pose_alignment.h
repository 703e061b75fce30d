// Moves a scene to where given camera poses say it is.
#pragma once

#include <span>

#include "server/vision/reconstruction/calibrated_scene.h"

namespace horopter {

// Similarity that brings the views' centres and rotations to the given poses: rotation by the mean
// of the relative ones, scale and place by the centres. With one pose the scale stays; with none,
// or centres that are one point, nothing changes.
void AlignToPoses(std::span<const ViewPrior> priors, CalibratedScene* scene);

}  // namespace horopter
