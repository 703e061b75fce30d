#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/matching/feature_tracks.h"
#include "server/vision/matching/match_features.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/on_plane.h"
#include "server/vision/matching/pair_geometry.h"
#include "server/vision/matching/plane_centres.h"
#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_links.h"
#include "server/vision/matching/three_views.h"
#include "server/vision/matching/view_graph.h"

namespace horopter {
namespace {

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
  HOROPTER_RETURN_IF_ERROR(Validate(options.features));
  if (!(options.ratio > 0.0 && options.ratio <= 1.0)) {
    return absl::InvalidArgumentError("matching: ratio must be in (0, 1]");
  }
  if (!(options.ransac_px > 0.0) || options.min_plane_inliers < 4 || options.max_keypoints < 16) {
    return absl::InvalidArgumentError(
        "matching: ransac_px > 0, min_plane_inliers >= 4 and max_keypoints >= 16 required");
  }
  return absl::OkStatus();
}

// Few views: all pairs; more: by overlap.
std::vector<std::pair<int, int>> PairsToCompare(std::span<const cv::Mat> images,
                                                const std::vector<MatchingView>& views,
                                                const MatchingOptions& options,
                                                const StopRequested& stop) {
  const int n = static_cast<int>(images.size());
  const ViewGraphOptions& graph = options.views;
  std::vector<ViewOverlap> overlaps;
  if (n > graph.all_up_to) {
    std::vector<OverlapSketch> sketches(n);
    ParallelFor(n, options.threads, [&](int v) {
      if (!IsStopRequested(stop))
        sketches[v] = SketchForOverlap(images[v], views[v].patches, options);
    });
    for (int a = 0; a < n; ++a) {
      for (int b = a + 1; b < n; ++b) overlaps.push_back({a, b, 0.0});
    }
    ParallelFor(static_cast<int>(overlaps.size()), options.threads, [&](int k) {
      ViewOverlap& o = overlaps[k];
      if (!IsStopRequested(stop))
        o.score = CountOverlapVotes(sketches[o.view_a], sketches[o.view_b]);
    });
  }
  return ChooseViewPairs(n, overlaps, graph);
}

// Matching of all pairs in its steps. What a pair's geometry is made of is looked at in one place:
// first all views of a plane together, then the pairs that this leaves out alone.
class PairMatcher {
 public:
  PairMatcher(const std::vector<MatchingView>& views,
              const MatchingOptions& options,
              const StopRequested& stop,
              MatchingResult* result)
      : views_(views), options_(options), stop_(stop), result_(*result) {}

  void Run(const std::vector<std::pair<int, int>>& pairs) {
    result_.pairs.resize(pairs.size());
    ForEachPair([&](int k) {
      const auto [a, b] = pairs[k];
      result_.pairs[k] = MatchPair(a, b, View(a), View(b), PlaneOf(a, b), options_.features);
    });
    LinkThroughPlanes();
    ForEachPair([&](int k) {
      PairGeometry& p = result_.pairs[k];
      if (p.F) return;
      EstimateEpipolarGeometry(
          View(p.view_a), View(p.view_b), PlaneOf(p.view_a, p.view_b), options_, &p);
      if (p.F) Rematch(&p);
    });
    CheckThreeViews();
    // Better matches join views that the first ones left out.
    if (!PlanesComplete()) LinkThroughPlanes();
  }

 private:
  const MatchingView& View(int v) const { return views_[v]; }

  std::optional<Eigen::Matrix3d> PlaneOf(int a, int b) const {
    if (result_.component[a] < 0 || result_.component[a] != result_.component[b])
      return std::nullopt;
    return result_.view_from_plane[b] * result_.view_from_plane[a].inverse();
  }

  template <typename Body>
  void ForEachPair(const Body& body) {
    ParallelFor(static_cast<int>(result_.pairs.size()), options_.threads, [&](int k) {
      if (!IsStopRequested(stop_)) body(k);
    });
  }

  void Rematch(PairGeometry* p) const {
    MatchAlongEpipolarLines(
        View(p->view_a), View(p->view_b), PlaneOf(p->view_a, p->view_b), p, options_.features);
  }

  bool PlanesComplete() const {
    return std::all_of(result_.pairs.begin(), result_.pairs.end(), [&](const PairGeometry& p) {
      return p.F || !PlaneOf(p.view_a, p.view_b);
    });
  }

  // A pair that a plane does not link to the others was estimated alone.
  void CheckThreeViews() {
    std::vector<const ImageFeatures*> features;
    for (const MatchingView& view : views_) features.push_back(view.features);
    std::vector<char> alone;
    for (const PairGeometry& p : result_.pairs) alone.push_back(!PlaneOf(p.view_a, p.view_b));
    result_.counts["pairs_inconsistent"] =
        RefuseInconsistentPairs(features, alone, options_.three_views, &result_.pairs);
  }

  // Where a plane joins views, one set of camera centres gives all their pairs an F: pairs too weak
  // alone get theirs, and all agree with each other.
  void LinkThroughPlanes() {
    const std::vector<FeatureTrack> tracks =
        JoinTracks(JunctionLinks(result_.pairs, /*accepted_only=*/false));
    int components = 0;
    for (int c : result_.component) components = std::max(components, c + 1);
    std::vector<char> linked(result_.pairs.size(), 0);
    for (int component = 0; component < components; ++component)
      LinkComponent(component, tracks, &linked);
    ForEachPair([&](int k) {
      if (linked[k]) Rematch(&result_.pairs[k]);
    });
  }

  void LinkComponent(int component,
                     const std::vector<FeatureTrack>& tracks,
                     std::vector<char>* linked) {
    std::vector<int> position(views_.size(), -1), of_view;
    std::vector<PlaneView> views;
    for (size_t v = 0; v < views_.size(); ++v) {
      if (result_.component[v] != component) continue;
      position[v] = static_cast<int>(views.size());
      views.push_back({result_.view_from_plane[v]});
      of_view.push_back(static_cast<int>(v));
    }
    if (views.size() < 3) return;
    std::vector<PlanePoint> points;
    for (const FeatureTrack& track : tracks) {
      PlanePoint point;
      for (const FeatureTrack::Feature& f : track.features) {
        if (position[f.view] < 0) continue;
        point.observations.push_back(
            {position[f.view], views_[f.view].features->junctions[f.feature].point});
      }
      if (point.observations.size() >= 2) points.push_back(std::move(point));
    }
    PlaneCentresOptions options = options_.centres;
    options.seed = options_.seed;
    for (const PlaneCentres::Pair& p : EstimatePlaneCentres(views, points, options).pairs) {
      const int a = of_view[p.view_a], b = of_view[p.view_b];
      if (!HasPlausibleCameras(p.F, View(a), View(b))) continue;
      for (size_t k = 0; k < result_.pairs.size(); ++k) {
        PairGeometry& pair = result_.pairs[k];
        if (pair.view_a != a || pair.view_b != b) continue;
        pair.F = p.F;
        pair.refusal.clear();
        (*linked)[k] = 1;
      }
    }
  }

  const std::vector<MatchingView>& views_;
  const MatchingOptions& options_;
  const StopRequested& stop_;
  MatchingResult& result_;
};

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
  std::vector<MatchingView> prepared(views);
  ParallelFor(views, options.threads, [&](int i) {
    if (!IsStopRequested(stop))
      prepared[i] = PrepareMatchingView(images[i], features[i], options.graph);
  });
  const std::vector<std::pair<int, int>> pairs = PairsToCompare(images, prepared, options, stop);
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
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

  PairMatcher(prepared, options, stop, &result).Run(pairs);
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
  JoinAllTracks(&result);
  result.segment_on_plane = FindSegmentsOnPlane(features, result, options.on_plane);
  result.counts["identical_views"] = CountIdenticalViews(images, pairs);
  return result;
}

}  // namespace horopter
