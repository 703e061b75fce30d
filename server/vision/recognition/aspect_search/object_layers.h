// What parts that are known to be there hide and explain of an image.
#pragma once

#include <span>

#include "server/vision/recognition/aspect_search/aspect_score.h"

namespace horopter {

// Whether one of the parts stands at a working pixel, nearer than `inverse_depth` (1 / m); 0: at
// any depth.
bool IsCovered(std::span<const ObjectLayer* const> others, int x, int y, float inverse_depth);

// Whether one of the parts has a like-directed edge there; bin: AspectBin of the direction.
bool IsEdgeOf(std::span<const ObjectLayer* const> others, int x, int y, int bin);

}  // namespace horopter
