// Every place and turn of a part on one of its faces, coarsely, on half maps of the images.
#pragma once

#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/aspect_scenes/object_on_plane.h"

namespace horopter {

// The best turns at each place of a grid (kStandingStepShare), one of each third of
// all turns, that enough views support; nothing when stopped.
std::vector<StandingPlace> SearchFace(const ObjectOnPlane& object,
                                      int face,
                                      const StopRequested& stop);

}  // namespace horopter
