// Whether it is worth while to ask how the ground moves before aspects are searched.
#pragma once

#include <span>

#include "server/vision/features/features.h"
#include "server/vision/recognition/options.h"

namespace horopter {

// Three images and more have so many edges that the ground must be textured
// (AspectRouteOptions::textured_share).
bool GroundComesFirst(std::span<const ImageFeatures> features, const AspectRouteOptions& options);

}  // namespace horopter
