// The true cameras of a scene as something else than its parts may know them: up to scale, and off.
#pragma once

#include "client/bop_dataset.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

// From the scene's camera poses, or from an object that is once in every image; no views without
// either. Each camera is turned by deviations of turn_deg about each axis; the focal lengths are
// off by deviations of focal_share, of the whole set and half of that of each image, and the
// cameras as much farther away as they then draw larger. The unit is some number of metres. The
// same for the same scene.
KnownCameras DisturbedCameras(const BopScene& scene, double turn_deg, double focal_share);

}  // namespace horopter
