#include "server/vision/reconstruction/incremental_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "server/base/status_macros.h"
#include "server/vision/matching/relative_pose.h"
#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/camera_resection.h"
#include "server/vision/reconstruction/scene_views.h"
#include "server/vision/reconstruction/structure.h"

namespace horopter {
namespace {

constexpr double kDistinctSceneLogFocal = 0.1;  // scenes nearer than that are one
constexpr double kOnPlaneWeight = 0.8;  // of points that one homography explains, in a start
constexpr double kStartGatePx = 2.5;    // of the five-point method
constexpr int kSceneAdjustments = 2;    // each time: outliers of the first mislead it
// A focal length that others of the same camera have given is believed to this, in a view's
// resection.
constexpr double kSharedFocalLogSigma = 0.05;

// One start and what grows from it.
class Growth {
 public:
  Growth(const MultiviewTracks& tracks,
         const TrackIndex& index,
         std::span<const ViewPrior> priors,
         const std::vector<int>& camera_of_view,
         const IncrementalOptions& options,
         const StopRequested& stop)
      : tracks_(tracks),
        index_(index),
        priors_(priors),
        options_(options),
        stop_(stop),
        camera_of_view_(camera_of_view) {
    state_.scene.views.resize(tracks.sizes.size());
    state_.scene.points.resize(tracks.points);
    state_.scene.lines.resize(tracks.lines);
    state_.inliers = EmptyScene(tracks);
  }

  // False when the two views give no scene.
  bool Start(const SharedPoints& pair, double focal_widths) {
    CalibratedView a, b;
    a.camera = Camera(pair.view_a, focal_widths);
    b.camera = Camera(pair.view_b, focal_widths);
    std::vector<PointPair> points;
    for (int j = 0; j < tracks_.points; ++j) {
      const PointObservation *in_a = nullptr, *in_b = nullptr;
      for (const int k : index_.of_point[j]) {
        const PointObservation& o = tracks_.point_observations[k];
        if (o.view == pair.view_a) in_a = &o;
        if (o.view == pair.view_b) in_b = &o;
      }
      if (in_a == nullptr || in_b == nullptr) continue;
      points.push_back(
          {NormalizedPoint(a.camera, in_a->pixel), NormalizedPoint(b.camera, in_b->pixel)});
    }
    const double gate = kStartGatePx / std::min(a.camera.focal_px, b.camera.focal_px);
    const std::optional<Rigid3> b_from_a = EstimateRelativePose(points, gate);
    if (!b_from_a) return false;
    state_.scene.views[pair.view_a] = a;
    state_.scene.views[pair.view_b] = b;
    state_.scene.views[pair.view_b]->camera_from_scene = *b_from_a;
    return Settle(options_.start_gate_px, 1);
  }

  // Registers one view after the other, the one that sees most known points first.
  void Grow() {
    std::vector<bool> failed(tracks_.sizes.size(), false);
    while (!IsStopRequested(stop_)) {
      int next = -1;
      std::vector<PointSight> most;
      for (size_t v = 0; v < tracks_.sizes.size(); ++v) {
        if (state_.scene.views[v] || failed[v]) continue;
        std::vector<PointSight> sights = SightsOf(static_cast<int>(v));
        if (next >= 0 && sights.size() <= most.size()) continue;
        next = static_cast<int>(v);
        most = std::move(sights);
      }
      if (next < 0 || std::ssize(most) < options_.min_points) return;
      failed[next] = true;
      const std::optional<CalibratedView> view = Resect(next, most);
      if (!view) continue;
      IncrementalScene before = state_;
      state_.scene.views[next] = view;
      if (!Settle(options_.start_gate_px, kSceneAdjustments)) {
        state_ = std::move(before);
        continue;
      }
      for (size_t v = 0; v < failed.size(); ++v) failed[v] = failed[v] && state_.scene.views[v];
    }
  }

  // Nothing where too little is left.
  std::optional<IncrementalScene> Finish() {
    if (IsStopRequested(stop_) || !Settle(options_.gate_px, kSceneAdjustments)) return std::nullopt;
    state_.cost = UnexplainedCost(tracks_, state_.scene, options_.outlier_chi2);
    state_.views = RegisteredViews(state_.scene.views);
    state_.camera_of_view = camera_of_view_;
    return std::move(state_);
  }

 private:
  ViewPrior PriorOf(int view) const { return priors_.empty() ? ViewPrior() : priors_[view]; }

  PinholeCamera Camera(int view, double focal_widths) const {
    const ImageSize& size = tracks_.sizes[view];
    const ViewPrior prior = PriorOf(view);
    PinholeCamera camera =
        CenteredCamera(size.width, size.height, prior.focal_px.value_or(focal_widths * size.width));
    if (prior.principal_point_px) {
      camera.cx = prior.principal_point_px->x();
      camera.cy = prior.principal_point_px->y();
    }
    camera.k1 = prior.k1.value_or(0.0);
    return camera;
  }

  // Structure from the cameras, then both together, with the observations that agree.
  bool Settle(double gate_px, int adjustments) {
    for (int round = 0; round < adjustments; ++round) {
      Structure structure = TriangulateAll(tracks_, index_, state_.scene.views, gate_px);
      state_.scene.points = std::move(structure.points);
      state_.inliers.point_inlier = std::move(structure.point_agrees);
      const auto known = std::count_if(state_.scene.points.begin(),
                                       state_.scene.points.end(),
                                       [](const auto& X) { return X.has_value(); });
      if (known < options_.min_points || IsStopRequested(stop_)) return false;
      CalibratedBundleOptions bundle = options_.bundle;
      bundle.camera_of_view = camera_of_view_;
      bundle.tied_focal_log_sigma *= options_.loose_tie;
      bundle.tied_principal_point_sigma_px *= options_.loose_tie;
      bundle.tied_k1_sigma *= options_.loose_tie;
      state_.summary = AdjustCalibrated(tracks_, state_.inliers, priors_, bundle, &state_.scene);
      if (!state_.summary.usable) return false;
    }
    return true;
  }

  std::vector<PointSight> SightsOf(int view) const {
    std::vector<PointSight> sights;
    for (const int k : index_.points_in_view[view]) {
      const PointObservation& o = tracks_.point_observations[k];
      if (state_.scene.points[o.point]) sights.push_back({*state_.scene.points[o.point], o.pixel});
    }
    return sights;
  }

  // With the focal length that its camera has in other views, else with any.
  std::optional<CalibratedView> Resect(int view, std::span<const PointSight> sights) {
    const ViewPrior given = PriorOf(view);
    for (const bool shared : {true, false}) {
      ViewPrior prior = given;
      if (shared) {
        const CalibratedView* other = OfSameCamera(view);
        if (other == nullptr || given.focal_px) continue;
        prior.focal_px = other->camera.focal_px;
        prior.focal_log_sigma = kSharedFocalLogSigma;
        prior.k1 = other->camera.k1;
        prior.principal_point_px = Eigen::Vector2d(other->camera.cx, other->camera.cy);
      }
      ResectionOptions resection = options_.resection;
      resection.gate_px = options_.start_gate_px;
      const auto found = ResectPinhole(sights, {}, tracks_.sizes[view], prior, resection, stop_);
      if (!found.ok()) continue;
      if (!shared) {
        int fresh = 0;
        for (const int camera : camera_of_view_) fresh = std::max(fresh, camera + 1);
        camera_of_view_[view] = fresh;
      }
      return CalibratedView{*found, found->focal_log_sigma};
    }
    return std::nullopt;
  }

  const CalibratedView* OfSameCamera(int view) const {
    for (size_t v = 0; v < camera_of_view_.size(); ++v) {
      if (state_.scene.views[v] && camera_of_view_[v] == camera_of_view_[view])
        return &*state_.scene.views[v];
    }
    return nullptr;
  }

  const MultiviewTracks& tracks_;
  const TrackIndex& index_;
  std::span<const ViewPrior> priors_;
  const IncrementalOptions& options_;
  const StopRequested& stop_;
  std::vector<int> camera_of_view_;
  IncrementalScene state_;
};

// Pairs that a start may begin with, the most promising first.
std::vector<SharedPoints> RankStarts(std::span<const SharedPoints> pairs, int keep) {
  std::vector<SharedPoints> ranked(pairs.begin(), pairs.end());
  const auto worth = [](const SharedPoints& p) {
    return p.points - kOnPlaneWeight * p.on_homography;
  };
  std::stable_sort(ranked.begin(), ranked.end(), [&](const auto& x, const auto& y) {
    return worth(x) > worth(y);
  });
  if (std::ssize(ranked) > keep) ranked.resize(keep);
  return ranked;
}

}  // namespace

double UnexplainedCost(const MultiviewTracks& tracks,
                       const CalibratedScene& scene,
                       double outlier_chi2) {
  double cost = 0.0;
  for (const PointObservation& o : tracks.point_observations) {
    const auto& view = scene.views[o.view];
    const auto& X = scene.points[o.point];
    double squared = outlier_chi2;
    if (view && X) {
      const Eigen::Vector3d x = view->camera_from_scene * *X;
      if (x.z() > 0.0) squared = ((Project(view->camera, x) - o.pixel) / o.sigma_px).squaredNorm();
    }
    cost += std::min(squared, outlier_chi2);
  }
  return cost;
}

absl::StatusOr<std::vector<IncrementalScene>> ReconstructIncrementally(
    const MultiviewTracks& tracks,
    std::span<const SharedPoints> pairs,
    std::span<const ViewPrior> priors,
    const std::vector<int>& camera_of_view,
    const IncrementalOptions& options,
    const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Validate(tracks));
  HOROPTER_RETURN_IF_ERROR(Validate(priors, tracks.sizes.size()));
  const TrackIndex index = IndexTracks(tracks);
  std::vector<IncrementalScene> found;
  const double enough = options.sure_share * options.outlier_chi2 *
                        static_cast<double>(tracks.point_observations.size());
  bool sure = false;
  for (const SharedPoints& pair : RankStarts(pairs, options.start_pairs)) {
    for (const double focal : options.focal_widths) {
      if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
      Growth growth(tracks, index, priors, camera_of_view, options, stop);
      if (!growth.Start(pair, focal)) continue;
      growth.Grow();
      if (auto scene = growth.Finish()) {
        sure = sure || (scene->views == std::ssize(tracks.sizes) && scene->cost <= enough);
        found.push_back(*std::move(scene));
      }
    }
    if (sure) break;
  }
  std::stable_sort(
      found.begin(), found.end(), [](const auto& x, const auto& y) { return x.cost < y.cost; });
  std::vector<IncrementalScene> distinct;
  for (IncrementalScene& scene : found) {
    const bool seen = std::any_of(distinct.begin(), distinct.end(), [&](const auto& other) {
      return LargestFocalDifference(scene.scene.views, other.scene.views) <= kDistinctSceneLogFocal;
    });
    if (!seen) distinct.push_back(std::move(scene));
  }
  return distinct;
}

}  // namespace horopter
