// A station's cameras as the rig in which parts are looked for.
#pragma once

#include <vector>

#include "server/pipeline/station.h"
#include "server/vision/geometry/calibrated_camera.h"

namespace horopter {

// The cameras of a request's images with their places in the rig, metres, where all are known well
// enough to look for parts under them (fixed cameras, one image each); else empty.
std::vector<CalibratedCamera> KnownRig(const StationRequest& station);

}  // namespace horopter
