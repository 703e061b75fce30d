// Outlines of smooth things on a textured ground, as granite or a carpet has: where the texture's
// edges end.
#pragma once

#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// The border between the image's edges that are texture and what is free of edges, one point a
// cell, the normal towards the smooth side. Single grains leave the true outline by as much as they
// are wide and break its direction; the border is that of the largest discs that fit between the
// edges (an opening of the free place), smoothed. `textured`: per edge of the image, whether it is
// texture. Empty when none is.
std::vector<ImageEdgePoint> TextureBorder(const AspectImage& image,
                                          const std::vector<std::uint8_t>& textured,
                                          const AspectImageOptions& options);

}  // namespace horopter
