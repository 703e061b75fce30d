// Which closed curves belong to a ground that dots are strewn over, and which are a part's own
// holes before it.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

// For each of the curves whether it stands among others: whether edges, or places of edges that
// were dropped as texture, are about as near to it all around as they are to most of the curves.
// Around a part's holes there is its smooth surface. Pixels of the raster.
std::vector<char> AmongOthers(const PointRaster& raster,
                              const std::vector<Eigen::Vector2f>& texture,
                              const std::vector<std::vector<Eigen::Vector2f>>& curves);

}  // namespace horopter
