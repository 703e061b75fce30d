// The plane the recognised parts stand on, for whoever must not reach through it.
#pragma once

#include <optional>

#include "server/vision/euclidean/scene_bundle.h"
#include "server/vision/geometry/supporting_plane.h"

namespace horopter {

// From the plane's matched points; without them the plane under a stable pose of an object: of
// those below every other object and camera the one with most points of texture on it, where at
// least 20 and a fifth of all are, then that on which most objects rest. Of one that texture bears
// out objects may reach a tenth of their diameters below. Lowered until nothing stands in it, by 3
// mm at most where texture bears it out. Empty when there is none.
std::optional<SupportingPlane> FindSupportingPlane(const SceneBundle& bundle);

}  // namespace horopter
