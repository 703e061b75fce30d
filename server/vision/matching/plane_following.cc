#include "server/vision/matching/plane_following.h"

#include <Eigen/LU>
#include <cstddef>
#include <optional>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

// Of 707 proposals for parts-dev and parts-train those with at least so many aligned patches, and
// this share of the matched ones, were right within 3 px (638) but for 8, within 8 px but for 2.
constexpr int kMinPatches = 60;
constexpr double kMinPatchShare = 0.65;
constexpr std::size_t kNext = 2;  // views that each is compared with; more say the same again

}  // namespace

bool IsConfirmed(const PlaneAlignment& alignment) {
  const std::vector<PointPair>& inliers = alignment.estimate.inliers;
  const auto count = static_cast<int>(inliers.size());
  return count >= kMinPatches && count >= kMinPatchShare * alignment.matched &&
         ImplausibleHomography(alignment.estimate.b_from_a, inliers).empty();
}

PlaneHomography AsPlane(int view_a, int view_b, const PlaneEstimate& estimate) {
  PlaneHomography plane;
  plane.view_a = view_a;
  plane.view_b = view_b;
  plane.b_from_a = estimate.b_from_a;
  for (const PointPair& p : estimate.inliers) {
    plane.inliers_a.push_back(p.a);
    plane.inliers_b.push_back(p.b);
  }
  plane.information = estimate.information;
  return plane;
}

std::vector<PlaneHomography> FollowPlane(std::span<const cv::Mat> images,
                                         const PlaneInViews& plane,
                                         const AlignOptions& options,
                                         int threads,
                                         const StopRequested& stop) {
  std::vector<int> known;
  for (std::size_t v = 0; v < plane.size(); ++v) {
    if (plane[v]) known.push_back(static_cast<int>(v));
  }
  if (known.size() < 2) return {};
  std::vector<PatchImage> patches(images.size());
  ParallelFor(static_cast<int>(known.size()), threads, [&](int i) {
    if (!IsStopRequested(stop)) patches[known[i]] = PreparePatches(images[known[i]]);
  });
  std::vector<std::pair<int, int>> pairs;
  for (std::size_t i = 0; i < known.size(); ++i) {
    for (std::size_t j = i + 1; j < known.size() && j <= i + kNext; ++j)
      pairs.emplace_back(known[i], known[j]);
  }
  std::vector<std::optional<PlaneHomography>> found(pairs.size());
  ParallelFor(static_cast<int>(pairs.size()), threads, [&](int k) {
    if (IsStopRequested(stop)) return;
    const auto [a, b] = pairs[k];
    const PlaneAlignment aligned =
        AlignPlane(patches[a], patches[b], *plane[b] * plane[a]->inverse(), options);
    if (IsConfirmed(aligned)) found[k] = AsPlane(a, b, aligned.estimate);
  });
  std::vector<PlaneHomography> out;
  for (auto& f : found) {
    if (f) out.push_back(*std::move(f));
  }
  return out;
}

}  // namespace horopter
