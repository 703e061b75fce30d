#include "server/vision/matching/plane_links.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cstddef>
#include <functional>
#include <optional>

#include "server/base/parallel_for.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_following.h"
#include "server/vision/matching/plane_homography.h"
#include "server/vision/matching/plane_patches.h"

namespace horopter {
namespace {

// A homography of keypoints is worth aligning from kProposalInliers on and is believed without
// alignment (few, but sharp points on a blank plane) from kSureInliers on.
constexpr int kProposalInliers = 8;
constexpr int kSureInliers = 40;
constexpr double kTrianglePx = 2.0;  // median transfer error
// The images of parts-dev and parts-train have 0.49 at most (median 0.06), checkers and grids 0.64
// and more.
constexpr double kMaxRepeatedShare = 0.58;
// Links with fewer patches and a lower share do not end the search.
constexpr int kSurePatches = 250;
constexpr double kSurePatchShare = 0.85;
// Keypoints are looked for in the normalised image at a quarter of its size first: in parts-train
// kFewKeypoints of them join 61 of 83 views, all of 11 of 18 scenes, at a tenth of the time that
// kManyKeypoints at full size take.
constexpr double kQuickScale = 0.25;
constexpr int kFewKeypoints = 500;
constexpr double kQuickContrast = 5.0;  // times MatchingOptions::sift_contrast: enough stay
constexpr int kManyKeypoints = 2000;    // of an image at kSlowScale; for time
constexpr double kSlowScale = 0.5;      // of the image's size, twice kQuickScale
constexpr std::size_t kFewViews = 2;    // of which all is tried
// Of an image in which keypoints are sought; larger ones are reduced, for time and memory.
constexpr std::size_t kMostKeypointPixels = 1'300'000;
// Keypoints of views from above, at a quarter of the size: enough in 9 of the 12 scenes of
// parts-dev and parts-train whose views the first effort leaves apart.
constexpr double kAboveContrast = 3.0;  // times MatchingOptions::sift_contrast
constexpr std::size_t kBestSets = 5;    // of keypoint sets with most matches get a homography
constexpr std::size_t kAligned = 3;     // ... of which those with most inliers are aligned
constexpr int kFarthest = 4;            // views apart in the given order that are proposed a link
// Where nothing was found and no pair has so many matches, the supporting plane is blank: 35 at
// most in the four such scenes of parts-dev and parts-train, 67 and more in the others that the
// first effort fails.
constexpr int kBlankMatches = 45;
// Elevations tried for views from above.
constexpr double kElevationsRad[] = {0.44, 0.70, 1.05};  // 25, 40 and 60 degrees

// What is known of each pair's plane. Keypoints propose, the patches of the whole image decide
// (AlignPlane): links that they confirm replace the proposal, others stay out unless the proposal
// itself is beyond chance.
class PlaneLinks {
 public:
  // Gives keypoint sets of an image; each set of one image is matched with each of the other.
  using Detect = std::function<std::vector<KeypointSet>(const PatchImage& image)>;

  PlaneLinks(std::span<const cv::Mat> images,
             const std::vector<std::pair<int, int>>& pairs,
             const MatchingOptions& options,
             const StopRequested& stop)
      : pairs_(pairs),
        options_(options),
        stop_(stop),
        patches_(images.size()),
        ambiguous_(images.size(), 0),
        links_(pairs.size()),
        proposals_(pairs.size()),
        sure_(pairs.size(), 1),
        matches_(pairs.size(), 0) {
    ParallelFor(static_cast<int>(images.size()), options.threads, [&](int i) {
      if (IsStopRequested(stop_)) return;
      patches_[i] = PreparePatches(images[i]);
      ambiguous_[i] = !options_.repeated_texture && RepeatedShare(patches_[i]) > kMaxRepeatedShare;
    });
  }

  // Proposes links for the pairs that no chain of sure links joins: neighbours in the given order
  // first, since they are likely to join all others, then ever farther ones.
  void Propose(const Detect& detect) {
    std::vector<std::vector<KeypointSet>> keypoints(patches_.size());
    for (int apart = 1; apart <= kFarthest && !IsStopRequested(stop_); ++apart) {
      std::vector<char> wanted = Apart();
      for (size_t k = 0; k < pairs_.size(); ++k)
        wanted[k] &= std::min(pairs_[k].second - pairs_[k].first, kFarthest) == apart;
      DetectMissing(detect, wanted, &keypoints);
      ParallelFor(static_cast<int>(pairs_.size()), options_.threads, [&](int k) {
        if (wanted[k]) ProposePair(k, keypoints[pairs_[k].first], keypoints[pairs_[k].second]);
      });
      BelieveTriangles();
    }
  }

  // Aligns all pairs that links join, from the chained homography: it knows more than
  // the proposal of a pair alone.
  void LinkThroughChain() {
    const PlaneChain chain = Chain(false);
    ParallelFor(static_cast<int>(pairs_.size()), options_.threads, [&](int k) {
      const auto [a, b] = pairs_[k];
      if (IsStopRequested(stop_) || Ambiguous(k)) return;
      if (chain.component[a] < 0 || chain.component[a] != chain.component[b]) return;
      Align(k, chain.view_from_plane[b] * chain.view_from_plane[a].inverse(), true);
    });
  }

  // Three proposals that lead back to where they began are no accident: they are sure. Only what
  // was proposed for a pair alone counts: alignments from the chain repeat its mistakes.
  void BelieveTriangles() {
    std::vector<PlaneHomography> planes;
    std::vector<size_t> pair_of;
    for (size_t k = 0; k < proposals_.size(); ++k) {
      if (!proposals_[k]) continue;
      planes.push_back(*proposals_[k]);
      pair_of.push_back(k);
    }
    for (const auto& triangle : ClosedTriangles(planes, kTrianglePx)) {
      for (const size_t i : triangle) sure_[pair_of[i]] = 1;
    }
  }

  // The most matches any pair had.
  int MostMatches() const {
    return matches_.empty() ? 0 : *std::max_element(matches_.begin(), matches_.end());
  }

  bool AllJoined() const {
    const std::vector<char> apart = Apart();
    return std::count(apart.begin(), apart.end(), 1) == 0;
  }

  int CountAmbiguous() const {
    return static_cast<int>(std::count(ambiguous_.begin(), ambiguous_.end(), 1));
  }

  std::vector<PlaneHomography> Planes(bool sure_only) const {
    std::vector<PlaneHomography> planes;
    for (size_t k = 0; k < links_.size(); ++k) {
      if (links_[k] && (sure_[k] || !sure_only)) planes.push_back(*links_[k]);
    }
    return planes;
  }

 private:
  bool Ambiguous(size_t k) const {
    return ambiguous_[pairs_[k].first] || ambiguous_[pairs_[k].second];
  }

  // Marks the pairs that no chain of sure links joins and that may be linked.
  std::vector<char> Apart() const {
    const std::vector<int> component = Chain(true).component;
    std::vector<char> apart;
    for (size_t k = 0; k < pairs_.size(); ++k) {
      const auto [a, b] = pairs_[k];
      apart.push_back(!Ambiguous(k) && (component[a] < 0 || component[a] != component[b]));
    }
    return apart;
  }

  void DetectMissing(const Detect& detect,
                     const std::vector<char>& wanted,
                     std::vector<std::vector<KeypointSet>>* keypoints) const {
    std::vector<char> needed(patches_.size(), 0);
    for (size_t k = 0; k < pairs_.size(); ++k) {
      if (wanted[k]) needed[pairs_[k].first] = needed[pairs_[k].second] = 1;
    }
    ParallelFor(static_cast<int>(patches_.size()), options_.threads, [&](int i) {
      if (needed[i] && (*keypoints)[i].empty() && !IsStopRequested(stop_))
        (*keypoints)[i] = detect(patches_[i]);
    });
  }

  void ProposePair(int k,
                   const std::vector<KeypointSet>& sets_a,
                   const std::vector<KeypointSet>& sets_b) {
    MatchingOptions of_proposal = options_;
    of_proposal.min_plane_inliers = std::min(kProposalInliers, options_.min_plane_inliers);
    std::vector<std::vector<PointPair>> matched;
    for (const KeypointSet& a : sets_a) {
      for (const KeypointSet& b : sets_b) {
        if (IsStopRequested(stop_)) return;
        matched.push_back(MatchKeypoints(a, b, options_.ratio));
        matches_[k] = std::max(matches_[k], static_cast<int>(matched.back().size()));
      }
    }
    std::stable_sort(matched.begin(), matched.end(), [](const auto& x, const auto& y) {
      return x.size() > y.size();
    });
    if (matched.size() > kBestSets) matched.resize(kBestSets);
    std::vector<PlaneEstimate> proposals;
    for (const std::vector<PointPair>& matches : matched) {
      if (IsStopRequested(stop_)) return;
      auto found = EstimatePlane(matches, of_proposal);
      if (found) proposals.push_back(*std::move(found));
    }
    std::stable_sort(proposals.begin(), proposals.end(), [](const auto& x, const auto& y) {
      return x.inliers.size() > y.inliers.size();
    });
    for (size_t i = 0; i < std::min(proposals.size(), kAligned); ++i) {
      if (Align(k, proposals[i].b_from_a, false)) return;
    }
    if (!links_[k] && !proposals.empty() &&
        static_cast<int>(proposals[0].inliers.size()) >=
            std::max(kSureInliers, options_.min_plane_inliers))
      links_[k] = ToPlane(k, proposals[0]);
  }

  PlaneHomography ToPlane(int k, const PlaneEstimate& estimate) const {
    return AsPlane(pairs_[k].first, pairs_[k].second, estimate);
  }

  bool Align(int k, const Eigen::Matrix3d& b_from_a, bool from_chain) {
    const auto [a, b] = pairs_[k];
    AlignOptions options = options_.alignment;
    options.start_is_aligned = from_chain;
    const PlaneAlignment aligned = AlignPlane(patches_[a], patches_[b], b_from_a, options);
    if (!IsConfirmed(aligned)) return false;
    const int inliers = static_cast<int>(aligned.estimate.inliers.size());
    if (!from_chain) proposals_[k] = ToPlane(k, aligned.estimate);
    // A later alignment replaces only what fewer patches confirm.
    if (links_[k] && links_[k]->inliers_a.size() >= aligned.estimate.inliers.size()) return true;
    links_[k] = ToPlane(k, aligned.estimate);
    sure_[k] = inliers >= kSurePatches || inliers >= kSurePatchShare * aligned.matched;
    return true;
  }

  PlaneChain Chain(bool sure_only) const {
    return ChainPlanes(Planes(sure_only), static_cast<int>(patches_.size()), options_.loop_max_px);
  }

  const std::vector<std::pair<int, int>>& pairs_;
  const MatchingOptions& options_;
  const StopRequested& stop_;
  std::vector<PatchImage> patches_;
  std::vector<char> ambiguous_;  // per view
  std::vector<std::optional<PlaneHomography>> links_;
  std::vector<std::optional<PlaneHomography>> proposals_;  // aligned
  std::vector<char> sure_;                                 // per link
  std::vector<int> matches_;  // per pair: of the best keypoint sets so far
};

// What keypoints are sought in.
struct ScaledImage {
  cv::Mat grey;
  double scale = 1.0;  // of the whole image's size
};

ScaledImage ForKeypoints(const cv::Mat& grey, double scale) {
  ScaledImage image{grey, scale};
  while (image.grey.total() > kMostKeypointPixels) {
    image.grey = HalfSize(image.grey);
    image.scale /= 2;
  }
  return image;
}

}  // namespace

// Ever more expensive keypoints until all views are joined.
FoundPlanes FindPlanes(std::span<const cv::Mat> images,
                       const std::vector<std::pair<int, int>>& pairs,
                       const MatchingOptions& options,
                       const StopRequested& stop) {
  PlaneLinks links(images, pairs, options, stop);
  MatchingOptions few = options, some = options, many = options;
  few.max_keypoints = some.max_keypoints = std::min(options.max_keypoints, kFewKeypoints);
  few.sift_contrast = kQuickContrast * options.sift_contrast;
  some.sift_contrast = kAboveContrast * options.sift_contrast;
  many.max_keypoints = std::min(options.max_keypoints, kManyKeypoints);
  const auto straight = [](const ScaledImage& image, const MatchingOptions& o) {
    return std::vector<KeypointSet>{DetectPlaneKeypoints(image.grey, image.scale, o)};
  };
  const auto from_above = [](const ScaledImage& image, const MatchingOptions& o) {
    std::vector<KeypointSet> sets;
    for (const double elevation : kElevationsRad)
      sets.push_back(DetectKeypointsFromAbove(image.grey, image.scale, elevation, o));
    return sets;
  };
  const auto quarter = [](const PatchImage& image) {
    return ForKeypoints(image.normalized_quarter, kQuickScale);
  };
  const auto half = [](const PatchImage& image) {
    return ForKeypoints(image.normalized_half, kSlowScale);
  };
  const PlaneLinks::Detect efforts[] = {
      [&](const PatchImage& image) { return straight(quarter(image), few); },
      [&](const PatchImage& image) { return from_above(quarter(image), some); },
      [&](const PatchImage& image) { return straight(half(image), many); },
      [&](const PatchImage& image) { return from_above(half(image), few); }};
  for (size_t effort = 0; effort < std::size(efforts) && !IsStopRequested(stop); ++effort) {
    // So few views are cheap enough to try everything.
    const bool nothing = images.size() > kFewViews && links.Planes(false).empty();
    if (effort == 1 && nothing && links.MostMatches() < kBlankMatches) break;
    if (effort + 1 == std::size(efforts) && nothing) break;
    links.Propose(efforts[effort]);
    if (links.AllJoined()) break;
  }
  if (!IsStopRequested(stop)) links.LinkThroughChain();
  return {links.Planes(false), links.CountAmbiguous()};
}

}  // namespace horopter
