// Edges of a textured ground, as of granite, told from those of what lies on it.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// Chance level from which on edges are texture.
inline int TextureLimit(const AspectImageOptions& options) {
  return static_cast<int>(255 * options.max_texture);
}

// Drops the edges of textured places but for those with a smooth side, those inside of what has no
// grain or another colour than the ground, and their outlines; outlines that grains broke are
// added. Several edges may share a cell then. Returns the places of what was dropped, px; none: the
// edges are as they were. `image` has edges, their raster and texture; bgr: of its size.
std::vector<Eigen::Vector2f> DropTexture(const cv::Mat& bgr,
                                         const AspectImageOptions& options,
                                         AspectImage* image);

}  // namespace horopter
