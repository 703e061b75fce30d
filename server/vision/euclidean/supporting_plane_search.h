// The plane the recognised parts stand on, for whoever must not reach through it.
#pragma once

#include <optional>

#include "server/vision/euclidean/scene_bundle.h"
#include "server/vision/geometry/supporting_plane.h"

namespace horopter {

// From the plane's matched points; without them the stable pose of an object below which no other
// object and no camera lies, with most points of texture on its plane where these tell, and on
// which most objects stand. Lowered until nothing stands in it. Empty when no stable pose of any
// object leaves all others above.
std::optional<SupportingPlane> FindSupportingPlane(const SceneBundle& bundle);

}  // namespace horopter
