// Distance and chance maps of an image's edge points.
#pragma once

#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// Sets distance, half_distance, chance and texture from the edges and the size of the image.
void FillAspectMaps(int threads, AspectImage* image);

// The image's size and maps without some of its edges, one entry each; no contours, no grey values.
AspectImage WithoutEdges(const AspectImage& image, const std::vector<bool>& dropped);

}  // namespace horopter
