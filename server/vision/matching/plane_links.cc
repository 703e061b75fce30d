#include "server/vision/matching/plane_links.h"

#include <Eigen/Dense>
#include <algorithm>
#include <functional>
#include <optional>

#include "server/base/parallel_for.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_homography.h"
#include "server/vision/matching/plane_patches.h"

namespace horopter {
namespace {

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

}  // namespace

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

}  // namespace horopter
