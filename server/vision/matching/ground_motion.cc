#include "server/vision/matching/ground_motion.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <opencv2/core/mat.hpp>
#include <utility>

#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_links.h"

namespace horopter {
namespace {

constexpr int kLeastViews = 3;        // that say anything: two agree on much that is not there
constexpr int kFarthestCompared = 4;  // views apart in the given order that are compared

PlaneInViews Largest(const std::vector<int>& component,
                     const std::vector<Eigen::Matrix3d>& view_from_plane) {
  std::map<int, int> sizes;
  for (const int c : component) {
    if (c >= 0) ++sizes[c];
  }
  int largest = -1;
  for (const auto& [c, size] : sizes) {
    if (size >= kLeastViews && (largest < 0 || size > sizes[largest])) largest = c;
  }
  PlaneInViews out(component.size());
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (largest >= 0 && component[v] == largest) out[v] = view_from_plane[v];
  }
  return out;
}

}  // namespace

PlaneInViews LargestPlane(const MatchingResult& matching) {
  return Largest(matching.component, matching.view_from_plane);
}

PlaneInViews FindGround(std::span<const cv::Mat> images,
                        const MatchingOptions& options,
                        const StopRequested& stop) {
  MatchingOptions of_ground = options;
  of_ground.repeated_texture = true;
  const int views = static_cast<int>(images.size());
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views && b <= a + kFarthestCompared; ++b) pairs.emplace_back(a, b);
  }
  const FoundPlanes found = FindPlanes(images, pairs, of_ground, stop);
  const PlaneChain chain = ChainPlanes(found.planes, views, options.loop_max_px);
  return Largest(chain.component, chain.view_from_plane);
}

}  // namespace horopter
