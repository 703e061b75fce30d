#include "server/vision/recognition/ground_question.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {

bool GroundComesFirst(std::span<const ImageFeatures> features, const AspectRouteOptions& options) {
  constexpr std::size_t kLeastViews = 3;  // that say what moves with the ground
  if (features.size() < kLeastViews) return false;
  std::vector<double> shares;
  for (const ImageFeatures& f : features) {
    std::size_t points = 0;
    for (const EdgeChain& chain : f.chains) points += chain.points.size();
    shares.push_back(static_cast<double>(points) / std::max(1.0, 1.0 * f.width * f.height));
  }
  return Median(&shares) >= options.textured_share;
}

}  // namespace horopter
