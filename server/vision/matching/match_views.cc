#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <opencv2/core.hpp>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/matching/feature_tracks.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/on_plane.h"
#include "server/vision/matching/pair_geometry.h"
#include "server/vision/matching/plane_centres.h"
#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_homography.h"
#include "server/vision/matching/plane_patches.h"

namespace horopter {
namespace {

constexpr int kAllPairsUpTo =
    8;  // views; with more, only near ones in the given order are compared
constexpr int kNeighbourReach = 3;
// A homography of keypoints is worth aligning from kProposalInliers on and is believed without
// alignment (few, but sharp points on a blank plane) from kSureInliers on.
constexpr int kProposalInliers = 8;
constexpr int kSureInliers = 40;
// Of 707 proposals for parts-dev and parts-train those with at least so many aligned patches, and
// this share of the matched ones, were right within 3 px (638) but for 8, within 8 px but for 2.
constexpr int kMinPatches = 60;
constexpr double kMinPatchShare = 0.65;
// Links with fewer patches and a lower share do not end the search.
constexpr int kSurePatches = 250;
constexpr double kSurePatchShare = 0.85;
constexpr int kFewKeypoints = 2000;
// Elevations tried for views from above.
constexpr double kElevationsRad[] = {0.44, 0.70, 1.05};  // 25, 40 and 60 degrees
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

// What is known of each pair's plane. Keypoints propose, the patches of the whole image decide
// (AlignPlane): links that they confirm replace the proposal, others stay out unless the proposal
// itself is beyond chance.
class PlaneLinks {
 public:
  PlaneLinks(std::span<const cv::Mat> images,
             const std::vector<std::pair<int, int>>& pairs,
             const MatchingOptions& options,
             const StopRequested& stop)
      : images_(images),
        pairs_(pairs),
        options_(options),
        stop_(stop),
        links_(pairs.size()),
        sure_(pairs.size(), 1) {
    patches_.resize(images.size());
    ParallelFor(static_cast<int>(images.size()), options.threads, [&](int i) {
      if (!IsStopRequested(stop_)) patches_[i] = PreparePatches(images_[i]);
    });
  }

  // `detect` gives keypoint sets of image i; each set of one image is matched with each of the
  // other.
  using Detect = std::function<std::vector<KeypointSet>(const cv::Mat& image)>;
  // Proposes links for the pairs marked in `wanted`.
  void Propose(const Detect& detect, const std::vector<char>& wanted) {
    std::vector<char> needed(images_.size(), 0);
    for (size_t k = 0; k < pairs_.size(); ++k) {
      if (wanted[k]) needed[pairs_[k].first] = needed[pairs_[k].second] = 1;
    }
    std::vector<std::vector<KeypointSet>> keypoints(images_.size());
    ParallelFor(static_cast<int>(images_.size()), options_.threads, [&](int i) {
      if (needed[i] && !IsStopRequested(stop_)) keypoints[i] = detect(images_[i]);
    });
    MatchingOptions of_proposal = options_;
    of_proposal.min_plane_inliers = std::min(kProposalInliers, options_.min_plane_inliers);
    ParallelFor(static_cast<int>(pairs_.size()), options_.threads, [&](int k) {
      if (!wanted[k]) return;
      std::optional<PlaneEstimate> best;
      for (const KeypointSet& a : keypoints[pairs_[k].first]) {
        for (const KeypointSet& b : keypoints[pairs_[k].second]) {
          if (IsStopRequested(stop_)) return;
          auto found = EstimatePlane(a, b, of_proposal);
          if (found && (!best || found->inliers.size() > best->inliers.size()))
            best = std::move(found);
        }
      }
      if (!best) return;
      if (Align(k, best->b_from_a)) return;
      if (!links_[k] && static_cast<int>(best->inliers.size()) >=
                            std::max(kSureInliers, options_.min_plane_inliers))
        links_[k] = ToPlane(k, *best);
    });
  }

  // Pairs that other links join: the chained homography is the proposal.
  void LinkThroughChain() {
    const PlaneChain chain = Chain(false);
    ParallelFor(static_cast<int>(pairs_.size()), options_.threads, [&](int k) {
      const auto [a, b] = pairs_[k];
      if (links_[k] || IsStopRequested(stop_)) return;
      if (chain.component[a] < 0 || chain.component[a] != chain.component[b]) return;
      Align(k, chain.view_from_plane[b] * chain.view_from_plane[a].inverse());
    });
  }

  // Marks the pairs that no chain of sure links joins.
  std::vector<char> Apart() const {
    const std::vector<int> component = Chain(true).component;
    std::vector<char> apart;
    for (const auto& [a, b] : pairs_)
      apart.push_back(component[a] < 0 || component[a] != component[b]);
    return apart;
  }

  std::vector<PlaneHomography> Planes(bool sure_only) const {
    std::vector<PlaneHomography> planes;
    for (size_t k = 0; k < links_.size(); ++k) {
      if (links_[k] && (sure_[k] || !sure_only)) planes.push_back(*links_[k]);
    }
    return planes;
  }

 private:
  PlaneHomography ToPlane(int k, const PlaneEstimate& estimate) const {
    PlaneHomography plane;
    plane.view_a = pairs_[k].first;
    plane.view_b = pairs_[k].second;
    plane.b_from_a = estimate.b_from_a;
    for (const PointPair& p : estimate.inliers) {
      plane.inliers_a.push_back(p.a);
      plane.inliers_b.push_back(p.b);
    }
    return plane;
  }

  bool Align(int k, const Eigen::Matrix3d& b_from_a) {
    const auto [a, b] = pairs_[k];
    const PlaneAlignment aligned = AlignPlane(patches_[a], patches_[b], b_from_a, {});
    const int inliers = static_cast<int>(aligned.estimate.inliers.size());
    if (inliers < kMinPatches || inliers < kMinPatchShare * aligned.matched) return false;
    if (!ImplausibleHomography(aligned.estimate.b_from_a, aligned.estimate.inliers).empty())
      return false;
    // A later proposal replaces only what fewer patches confirm.
    if (links_[k] && links_[k]->inliers_a.size() >= aligned.estimate.inliers.size()) return true;
    links_[k] = ToPlane(k, aligned.estimate);
    sure_[k] = inliers >= kSurePatches || inliers >= kSurePatchShare * aligned.matched;
    return true;
  }

  PlaneChain Chain(bool sure_only) const {
    return ChainPlanes(Planes(sure_only), static_cast<int>(images_.size()), options_.loop_max_px);
  }

  std::span<const cv::Mat> images_;
  const std::vector<std::pair<int, int>>& pairs_;
  const MatchingOptions& options_;
  const StopRequested& stop_;
  std::vector<PatchImage> patches_;
  std::vector<std::optional<PlaneHomography>> links_;
  std::vector<char> sure_;  // per link
};

// Proposals from ever more expensive keypoints until all views are joined.
std::vector<PlaneHomography> FindPlanes(std::span<const cv::Mat> images,
                                        const std::vector<std::pair<int, int>>& pairs,
                                        const MatchingOptions& options,
                                        const StopRequested& stop) {
  PlaneLinks links(images, pairs, options, stop);
  MatchingOptions few = options;
  few.max_keypoints = std::min(options.max_keypoints, kFewKeypoints);
  const PlaneLinks::Detect efforts[] = {
      [&](const cv::Mat& image) {
        return std::vector<KeypointSet>{DetectPlaneKeypoints(image, /*normalize=*/true, few)};
      },
      // Coarse texture survives in the raw image that normalising drowns in noise.
      [&](const cv::Mat& image) {
        return std::vector<KeypointSet>{DetectPlaneKeypoints(image, /*normalize=*/false, few)};
      },
      [&](const cv::Mat& image) {
        std::vector<KeypointSet> sets;
        for (const double elevation : kElevationsRad)
          sets.push_back(DetectKeypointsFromAbove(image, elevation, few));
        return sets;
      },
  };
  for (const PlaneLinks::Detect& detect : efforts) {
    const std::vector<char> apart = links.Apart();
    if (IsStopRequested(stop) || std::count(apart.begin(), apart.end(), 1) == 0) break;
    links.Propose(detect, apart);
  }
  if (!IsStopRequested(stop)) links.LinkThroughChain();
  return links.Planes(false);
}

// Where the plane joins views, one set of camera centres gives all their pairs an F: pairs too weak
// alone get theirs, and all agree with each other.
void LinkThroughPlane(std::span<const cv::Mat> images,
                      std::span<const ImageFeatures> features,
                      const std::vector<MatchingView>& prepared,
                      const MatchingOptions& options,
                      MatchingResult* result) {
  const int components =
      1 + *std::max_element(result->component.begin(), result->component.end());
  const std::vector<FeatureTrack> tracks =
      JoinTracks(JunctionLinks(result->pairs, /*accepted_only=*/false));
  for (int component = 0; component < components; ++component) {
    std::vector<int> position(images.size(), -1);
    std::vector<PlaneView> views;
    std::vector<int> of_view;
    for (size_t v = 0; v < images.size(); ++v) {
      if (result->component[v] != component) continue;
      position[v] = static_cast<int>(views.size());
      views.push_back({result->view_from_plane[v]});
      of_view.push_back(static_cast<int>(v));
    }
    if (views.size() < 3) continue;
    std::vector<PlanePoint> points;
    for (const FeatureTrack& track : tracks) {
      PlanePoint point;
      for (const FeatureTrack::Feature& f : track.features) {
        if (position[f.view] >= 0)
          point.observations.push_back(
              {position[f.view], features[f.view].junctions[f.feature].point});
      }
      if (point.observations.size() >= 2) points.push_back(std::move(point));
    }
    PlaneCentresOptions centres_options;
    centres_options.seed = options.seed;
    const PlaneCentres centres = EstimatePlaneCentres(views, points, centres_options);
    std::vector<PairGeometry*> wanted;
    for (const PlaneCentres::Pair& p : centres.pairs) {
      for (PairGeometry& pair : result->pairs) {
        if (pair.view_a != of_view[p.view_a] || pair.view_b != of_view[p.view_b]) continue;
        pair.F = p.F;
        pair.refusal.clear();
        wanted.push_back(&pair);
      }
    }
    ParallelFor(static_cast<int>(wanted.size()), options.threads, [&](int k) {
      PairGeometry& pair = *wanted[k];
      const Eigen::Matrix3d b_from_a =
          result->view_from_plane[pair.view_b] * result->view_from_plane[pair.view_a].inverse();
      MatchAlongEpipolarLines({&images[pair.view_a], &prepared[pair.view_a]},
                              {&images[pair.view_b], &prepared[pair.view_b]},
                              b_from_a,
                              &pair);
    });
  }
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
  result.planes = FindPlanes(images, pairs, options, stop);
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

  std::vector<MatchingView> prepared(images.size());
  ParallelFor(views, options.threads, [&](int i) {
    if (!IsStopRequested(stop)) prepared[i] = PrepareMatchingView(images[i], features[i]);
  });
  result.pairs.resize(pairs.size());
  ParallelFor(static_cast<int>(pairs.size()), options.threads, [&](int k) {
    if (IsStopRequested(stop)) return;
    const auto [a, b] = pairs[k];
    std::optional<Eigen::Matrix3d> b_from_a;
    if (result.component[a] >= 0 && result.component[a] == result.component[b]) {
      b_from_a = result.view_from_plane[b] * result.view_from_plane[a].inverse();
    }
    result.pairs[k] = EstimatePairGeometry(
        a, b, {&images[a], &prepared[a]}, {&images[b], &prepared[b]}, b_from_a, options);
  });
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
  LinkThroughPlane(images, features, prepared, options, &result);
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
