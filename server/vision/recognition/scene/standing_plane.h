// The supporting plane as the parts say that stand on it.
#pragma once

#include <span>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

struct StandingPlaneOptions {
  double near_m = 0.025;      // feet of upright parts so near the plane count as standing on it
  double upright_rad = 0.14;  // between a stable pose's direction and the plane's normal
  double foot_sigma_m = 0.001;
  double tilt_sigma_rad = 0.02;   // prior of the given plane's normal
  double offset_sigma_m = 0.006;  // ... and of its offset
  double robust_scale_m = 0.002;  // Cauchy: a part on top of a flat one does not lift the plane
  int min_parts = 2;
};

// The plane moved to the feet of the upright parts near it: matched texture links to a plane
// through cameras whose lenses are known badly, parts through what they are themselves. Robust
// least squares of offset and tilt with the given plane as prior; the given plane where fewer parts
// stand near it.
SupportingPlane PlaneUnderParts(const JointContext& context,
                                std::span<const PlacedObject> parts,
                                const SupportingPlane& plane,
                                const StandingPlaneOptions& options = {});

}  // namespace horopter
