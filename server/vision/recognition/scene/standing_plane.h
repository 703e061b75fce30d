// The supporting plane as the parts say that stand on it.
#pragma once

#include <span>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// The plane moved to the feet of the upright parts near it: matched texture links to a plane
// through cameras whose lenses are known badly, parts through what they are themselves. Robust
// least squares of offset and tilt with the given plane as prior; the given plane where fewer parts
// stand near it.
SupportingPlane PlaneUnderObjects(const JointContext& context,
                                  std::span<const PlacedObject> models,
                                  const SupportingPlane& plane);

}  // namespace horopter
