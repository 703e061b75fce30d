#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/on_plane.h"
#include "server/vision/matching/pair_geometry.h"
#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_links.h"

namespace horopter {
namespace {

constexpr int kAllPairsUpTo =
    8;  // views; with more, only near ones in the given order are compared
constexpr int kNeighbourReach = 3;
constexpr double kIdenticalMeanDifference =
    0.5;  // grey levels; two exposures of one view differ by more

absl::Status ValidateInput(std::span<const cv::Mat> images,
                           std::span<const ImageFeatures> features,
                           const MatchingOptions& options) {
  if (images.size() != features.size()) {
    return absl::InvalidArgumentError("matching: " + std::to_string(images.size()) +
                                      " images but " + std::to_string(features.size()) +
                                      " feature sets");
  }
  for (size_t i = 0; i < images.size(); ++i) {
    const cv::Mat& image = images[i];
    if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_8UC3)) {
      return absl::InvalidArgumentError("matching: image " + std::to_string(i) +
                                        " is neither CV_8UC1 nor CV_8UC3");
    }
    if (image.cols != features[i].width || image.rows != features[i].height) {
      return absl::InvalidArgumentError("matching: image " + std::to_string(i) +
                                        " and its features differ in size");
    }
  }
  if (!(options.ratio > 0.0 && options.ratio <= 1.0)) {
    return absl::InvalidArgumentError("matching: ratio must be in (0, 1]");
  }
  if (!(options.ransac_px > 0.0) || options.min_plane_inliers < 4 || options.max_keypoints < 16) {
    return absl::InvalidArgumentError(
        "matching: ransac_px > 0, min_plane_inliers >= 4 and max_keypoints >= 16 required");
  }
  return absl::OkStatus();
}

std::vector<std::pair<int, int>> PairsToCompare(int views) {
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      if (views <= kAllPairsUpTo || b - a <= kNeighbourReach) pairs.emplace_back(a, b);
    }
  }
  return pairs;
}

// Pairs of views whose pixels are the same but for compression noise: they show one view twice.
int CountIdenticalViews(std::span<const cv::Mat> images,
                        const std::vector<std::pair<int, int>>& pairs) {
  int identical = 0;
  for (const auto& [a, b] : pairs) {
    if (images[a].size() != images[b].size() || images[a].type() != images[b].type()) continue;
    const double mean = cv::norm(images[a], images[b], cv::NORM_L1) /
                        (static_cast<double>(images[a].total()) * images[a].channels());
    identical += mean < kIdenticalMeanDifference;
  }
  return identical;
}

}  // namespace

absl::StatusOr<MatchingResult> MatchViews(std::span<const cv::Mat> images,
                                          std::span<const ImageFeatures> features,
                                          const MatchingOptions& options,
                                          const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(ValidateInput(images, features, options));
  const int views = static_cast<int>(images.size());
  const std::vector<std::pair<int, int>> pairs = PairsToCompare(views);
  MatchingResult result;
  FoundPlanes found = FindPlanes(images, pairs, options, stop);
  result.planes = std::move(found.planes);
  result.counts["ambiguous_views"] = found.ambiguous_views;
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");

  PlaneChain chain = ChainPlanes(result.planes, views, options.loop_max_px);
  result.counts["pairs_compared"] = static_cast<double>(pairs.size());
  result.counts["planes"] = static_cast<double>(result.planes.size());
  result.counts["planes_contradicted"] = chain.contradicted;
  result.counts["plane_rms_px"] = chain.rms_px;
  std::vector<PlaneHomography> kept;
  for (size_t k = 0; k < result.planes.size(); ++k) {
    if (chain.consistent[k]) kept.push_back(std::move(result.planes[k]));
  }
  result.planes = std::move(kept);
  result.component = std::move(chain.component);
  result.view_from_plane = std::move(chain.view_from_plane);

  result.pairs.resize(pairs.size());
  ParallelFor(static_cast<int>(pairs.size()), options.threads, [&](int k) {
    if (IsStopRequested(stop)) return;
    const auto [a, b] = pairs[k];
    std::optional<Eigen::Matrix3d> b_from_a;
    if (result.component[a] >= 0 && result.component[a] == result.component[b]) {
      b_from_a = result.view_from_plane[b] * result.view_from_plane[a].inverse();
    }
    result.pairs[k] = EstimatePairGeometry(
        a, b, {&images[a], &features[a]}, {&images[b], &features[b]}, b_from_a, options);
  });
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
  result.segment_on_plane = FindSegmentsOnPlane(features, result);
  result.counts["identical_views"] = CountIdenticalViews(images, pairs);
  for (const PairGeometry& pair : result.pairs) {
    result.counts["pairs_with_epipolar"] += pair.F.has_value();
    result.counts["junction_matches"] += static_cast<double>(pair.matches.size());
  }
  return result;
}

}  // namespace horopter
