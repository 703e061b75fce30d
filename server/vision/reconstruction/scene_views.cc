#include "server/vision/reconstruction/scene_views.h"

#include <algorithm>
#include <cmath>

namespace horopter {

int RegisteredViews(OptionalViews views) {
  return static_cast<int>(
      std::count_if(views.begin(), views.end(), [](const auto& view) { return view.has_value(); }));
}

double LargestFocalDifference(OptionalViews a, OptionalViews b) {
  double largest = 0.0;
  for (size_t v = 0; v < std::min(a.size(), b.size()); ++v) {
    if (!a[v] || !b[v]) continue;
    largest = std::max(largest, std::abs(std::log(a[v]->camera.focal_px / b[v]->camera.focal_px)));
  }
  return largest;
}

}  // namespace horopter
