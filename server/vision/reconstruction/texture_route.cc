#include "server/vision/reconstruction/texture_route.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/vision/reconstruction/incremental_scene.h"
#include "server/vision/reconstruction/point_planes.h"
#include "server/vision/reconstruction/relief_reversal.h"
#include "server/vision/reconstruction/scene_frame.h"
#include "server/vision/reconstruction/scene_views.h"
#include "server/vision/reconstruction/structure.h"
#include "server/vision/reconstruction/texture_fit.h"
#include "server/vision/reconstruction/texture_tracks.h"

namespace horopter {
namespace {

constexpr double kWorthAdjusting = 2.0;  // scenes of up to so many times the least cost
constexpr int kMinViewsOfLensEach = 4;   // three with a lens each explain what is wrong as well
constexpr int kMinViews = 3;             // two leave the focal length open
constexpr int kAdjustments = 2;          // of the whole scene
constexpr int kMaxDropRounds = 4;        // views that do not belong are dropped one after the other
constexpr double kSameLogFocal = 0.1;    // of one solution
// Relief turned inside out is worth adjusting where it fits to this before: perspective tells.
constexpr double kReversedPx = 6.0;
constexpr double kOtherTurnRad = 0.05;  // between cameras of it that are another solution

std::optional<AdjustedTexture> AdjustAll(const MultiviewTracks& tracks,
                                         const TrackIndex& index,
                                         const std::vector<std::optional<CalibratedView>>& views,
                                         std::span<const ViewPrior> priors,
                                         const std::vector<int>& camera_of_view,
                                         const TextureRouteOptions& options) {
  AdjustedTexture out;
  out.inliers = EmptyScene(tracks);
  out.scene.views = views;
  out.scene.points.resize(tracks.points);
  CalibratedBundleOptions bundle = options.growth.bundle;
  bundle.camera_of_view = camera_of_view;
  for (int round = 0; round < kAdjustments; ++round) {
    Structure structure = TriangulateAll(tracks, index, out.scene.views, options.growth.gate_px);
    out.scene.points = std::move(structure.points);
    out.inliers.point_inlier = std::move(structure.point_agrees);
    bundle.covariance = round + 1 == kAdjustments;
    out.summary = AdjustCalibrated(tracks, out.inliers, priors, bundle, &out.scene);
    if (!out.summary.usable) return std::nullopt;
  }
  return out;
}

// The steps in order; what stops it is the refusal.
class TextureRoute {
 public:
  TextureRoute(const TextureMatching& texture,
               std::span<const ImageSize> sizes,
               std::span<const ViewPrior> priors,
               const TextureRouteOptions& options,
               const StopRequested& stop)
      : texture_(texture),
        priors_(priors),
        options_(options),
        stop_(stop),
        tracks_(TracksOfTexture(texture, sizes)),
        index_(IndexTracks(tracks_)) {
    result_.views.resize(sizes.size());
    result_.view_refusals.resize(sizes.size());
    result_.view_matches.resize(sizes.size());
    camera_of_view_ = CamerasOfImages(sizes, priors);
  }

  // One solution, or as many as images cannot tell apart, each trusted; the likelier first.
  absl::StatusOr<std::vector<Reconstruction>> Run(bool keep_alternative) {
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<IncrementalScene> scenes, Grow());
    if (scenes.empty()) return One(Refused(NoScene()));
    if (!ChooseScene(scenes)) return One(Refused(kTooFewAgree));
    if (!alternative_) TurnReliefInsideOut();
    if (keep_alternative && alternative_) {
      TextureRoute other(*this);
      other.adjusted_ = std::move(alternative_->adjusted);
      other.camera_of_view_ = std::move(alternative_->camera_of_view);
      HOROPTER_ASSIGN_OR_RETURN(Reconstruction second, other.Finish());
      TextureRoute likelier(*this);
      HOROPTER_ASSIGN_OR_RETURN(Reconstruction first, likelier.Finish());
      if (first.trusted && second.trusted) {
        first.counts["texture_solutions"] = second.counts["texture_solutions"] = 2.0;
        return std::vector<Reconstruction>{std::move(first), std::move(second)};
      }
    }
    // What another solution says of the focal lengths is part of their deviation.
    spread_ = std::max(spread_, other_spread_);
    HOROPTER_ASSIGN_OR_RETURN(Reconstruction only, Finish());
    return One(std::move(only));
  }

 private:
  static constexpr char kTooFewAgree[] = "too few texture points agree";

  struct Alternative {
    AdjustedTexture adjusted;
    std::vector<int> camera_of_view;
  };

  static std::vector<Reconstruction> One(Reconstruction of) {
    std::vector<Reconstruction> out;
    out.push_back(std::move(of));
    return out;
  }

  // The chosen scene to its end.
  absl::StatusOr<Reconstruction> Finish() {
    if (!AdjustWithLenses() || !DropStrangers()) return Refused(kTooFewAgree);
    if (IsStopRequested(stop_)) return absl::CancelledError("reconstruction: cancelled");
    WidenDeviations();
    result_.refusal = Doubt();
    result_.trusted = result_.refusal.empty();
    Export();
    return std::move(result_);
  }

  absl::StatusOr<std::vector<IncrementalScene>> Grow() {
    std::vector<SharedPoints> pairs;
    for (const TexturePair& pair : texture_.pairs) {
      pairs.push_back(
          {pair.view_a, pair.view_b, static_cast<int>(pair.matches.size()), pair.on_homography});
    }
    return ReconstructIncrementally(FewTracks(tracks_, index_, options_.growth_of_view),
                                    pairs,
                                    priors_,
                                    camera_of_view_,
                                    options_.growth,
                                    stop_);
  }

  struct Tried {
    double cost = 0.0;
    Alternative scene;
  };

  // The scene that explains all tracks best, and those of other focal lengths that explain them as
  // well: one other is an alternative, more are a deviation.
  bool ChooseScene(const std::vector<IncrementalScene>& scenes) {
    std::vector<Tried> tried;
    size_t best = 0;
    for (const IncrementalScene& scene : scenes) {
      if (scene.views < scenes[0].views || scene.cost > kWorthAdjusting * scenes[0].cost) continue;
      auto adjusted =
          AdjustAll(tracks_, index_, scene.scene.views, priors_, scene.camera_of_view, options_);
      if (!adjusted) continue;
      const double cost = UnexplainedCost(tracks_, adjusted->scene, options_.growth.outlier_chi2);
      if (!tried.empty() && cost < tried[best].cost) best = tried.size();
      tried.push_back({cost, {*std::move(adjusted), scene.camera_of_view}});
    }
    if (tried.empty()) return false;
    cost_ = tried[best].cost;
    KeepAlternative(best, &tried);
    camera_of_view_ = std::move(tried[best].scene.camera_of_view);
    adjusted_ = std::move(tried[best].scene.adjusted);
    return true;
  }

  void KeepAlternative(size_t best, std::vector<Tried>* tried) {
    const auto difference = [&](size_t i, size_t j) {
      return LargestFocalDifference((*tried)[i].scene.adjusted.scene.views,
                                    (*tried)[j].scene.adjusted.scene.views);
    };
    std::vector<size_t> others;  // of equal cost and other focal lengths, the cheapest first
    for (size_t i = 0; i < tried->size(); ++i) {
      if (i == best || (*tried)[i].cost > options_.equal_cost * cost_) continue;
      if (difference(best, i) < kSameLogFocal) {
        spread_ = std::max(spread_, difference(best, i));
        continue;
      }
      other_spread_ = std::max(other_spread_, difference(best, i));
      others.push_back(i);
    }
    std::stable_sort(others.begin(), others.end(), [&](size_t i, size_t j) {
      return (*tried)[i].cost < (*tried)[j].cost;
    });
    const bool one_other = std::all_of(others.begin(), others.end(), [&](size_t i) {
      return difference(others[0], i) < kSameLogFocal;
    });
    if (!others.empty() && one_other) alternative_ = std::move((*tried)[others[0]].scene);
  }

  // What is shallow and seen from afar looks the same turned inside out, by cameras on the other
  // side (Necker's reversal): taken where it explains the images better, kept where it does as
  // well.
  void TurnReliefInsideOut() {
    CalibratedScene reversed = TurnedInsideOut(adjusted_->scene);
    double squared = 0.0;
    int count = 0;
    for (size_t k = 0; k < tracks_.point_observations.size(); ++k) {
      const PointObservation& o = tracks_.point_observations[k];
      if (!adjusted_->inliers.point_inlier[k] || !reversed.views[o.view] ||
          !reversed.points[o.point])
        continue;
      const CalibratedView& view = *reversed.views[o.view];
      squared +=
          (Project(view.camera, view.camera_from_scene * *reversed.points[o.point]) - o.pixel)
              .squaredNorm();
      ++count;
    }
    if (count == 0 || !(squared < kReversedPx * kReversedPx * count)) return;
    auto adjusted = AdjustAll(tracks_, index_, reversed.views, priors_, camera_of_view_, options_);
    if (!adjusted || LargestTurn(adjusted_->scene.views, adjusted->scene.views) < kOtherTurnRad)
      return;
    const double cost = UnexplainedCost(tracks_, adjusted->scene, options_.growth.outlier_chi2);
    const bool both = std::max(cost, cost_) <= options_.equal_cost * std::min(cost, cost_);
    if (cost < cost_) {
      std::swap(*adjusted_, *adjusted);
      cost_ = cost;
    }
    if (both) alternative_ = Alternative{*std::move(adjusted), camera_of_view_};
  }

  // One lens for the images of a camera; one each where that explains them better.
  bool AdjustWithLenses() {
    std::vector<int> apart(camera_of_view_.size());
    for (size_t v = 0; v < apart.size(); ++v) apart[v] = static_cast<int>(v);
    one_camera_ = camera_of_view_ != apart;
    if (!one_camera_ || RegisteredViews(adjusted_->scene.views) < kMinViewsOfLensEach) return true;
    std::optional<AdjustedTexture> each =
        AdjustAll(tracks_, index_, adjusted_->scene.views, priors_, apart, options_);
    if (!each) return true;
    const double gain = 1.0 - each->summary.cost / std::max(1e-9, adjusted_->summary.cost);
    result_.counts["lens_each_gain"] = gain;
    each_is_better_ = adjusted_->summary.cost > options_.equal_cost * each->summary.cost;
    if (gain <= options_.one_camera_gain) return true;
    one_camera_ = false;
    camera_of_view_ = std::move(apart);
    adjusted_ = std::move(each);
    return true;
  }

  // Views most of whose points the others contradict leave, and the rest is adjusted again.
  bool DropStrangers() {
    for (int round = 0; round < kMaxDropRounds; ++round) {
      auto [view, why] = WorstView(tracks_, *adjusted_, options_);
      if (view < 0) break;
      result_.view_refusals[view] = std::move(why);
      std::vector<std::optional<CalibratedView>> views = adjusted_->scene.views;
      views[view].reset();
      if (RegisteredViews(views) < 2) return false;
      adjusted_ = AdjustAll(tracks_, index_, views, priors_, camera_of_view_, options_);
      if (!adjusted_) return false;
    }
    return WorstView(tracks_, *adjusted_, options_).first < 0;
  }

  void WidenDeviations() {
    for (auto& view : adjusted_->scene.views) {
      if (!view) continue;
      view->focal_log_sigma = std::max(spread_,
                                       std::hypot(options_.sigma_factor * view->focal_log_sigma,
                                                  options_.focal_log_sigma_floor));
    }
  }

  // Why the cameras are not to be trusted; empty: they are.
  std::string Doubt() {
    const int views = RegisteredViews(adjusted_->scene.views);
    const double unexplained =
        UnexplainedShare(tracks_, adjusted_->scene, options_.growth.outlier_chi2);
    const double beside = ShareBesidePlane(texture_, adjusted_->scene, options_.plane_share);
    double sigma = 0.0, k1 = 0.0;
    for (const auto& view : adjusted_->scene.views) {
      if (!view) continue;
      sigma = std::max(sigma, view->focal_log_sigma);
      k1 = std::max(k1, std::abs(view->camera.k1));
    }
    result_.counts["texture_unexplained"] = unexplained;
    result_.counts["texture_beside_plane"] = beside;
    result_.counts["focal_log_sigma"] = sigma;
    if (views < kMinViews)
      return absl::StrFormat("%d views share texture, need %d", views, kMinViews);
    if (!adjusted_->summary.covariance) return "the covariance cannot be computed";
    if (unexplained > options_.max_unexplained) {
      return absl::StrFormat("the texture's matches contradict each other (%.0f %%)",
                             100.0 * unexplained);
    }
    if (k1 > options_.max_k1)
      return absl::StrFormat(
          "only a lens of k1 %.2f would explain the texture, at most %.2f is believed",
          k1,
          options_.max_k1);
    const bool lenses_open = std::none_of(
        priors_.begin(), priors_.end(), [](const ViewPrior& p) { return p.focal_px.has_value(); });
    // Over a plane a tie that is wrong shows in nothing else.
    if ((!one_camera_ || each_is_better_) && lenses_open && beside < 0.5)
      return "the texture is a plane and the images differ in focal length";
    if (!(sigma <= kMaxTrustedFocalSigma)) {
      return absl::StrFormat("focal length known to %.0f %%, need %.0f %%",
                             100.0 * std::min(sigma, 10.0),
                             100.0 * kMaxTrustedFocalSigma);
    }
    return "";
  }

  std::string NoScene() const {
    if (texture_.pairs.empty()) return "no two views share texture";
    bool plane = true;
    for (const TexturePair& pair : texture_.pairs)
      plane = plane && pair.on_homography > options_.plane_share * std::ssize(pair.matches);
    return plane ? "no parallax: one homography explains the texture of every pair"
                 : "no pair of views gives a start";
  }

  Reconstruction Refused(std::string why) {
    for (std::string& of_view : result_.view_refusals)
      if (of_view.empty()) of_view = why;
    result_.refusal = std::move(why);
    return std::move(result_);
  }

  // The world has z = 0 in the plane that things stand on, where there is one.
  SimilarityTransform WorldFromScene() {
    const CalibratedScene& scene = adjusted_->scene;
    const SimilarityTransform facing = FacingTheCameras(scene);
    std::vector<Eigen::Vector3d> points;
    for (int j = 0; j < tracks_.points; ++j) {
      if (scene.points[j]) points.push_back(*scene.points[j]);
    }
    const double tolerance = options_.plane_tolerance / facing.scale;
    std::vector<PointPlane> planes = FindPointPlanes(points, tolerance, options_.planes);
    const int support = SupportingPlaneOf(points, scene.views, tolerance, options_.planes, &planes);
    result_.counts["texture_planes"] = static_cast<double>(planes.size());
    if (support < 0) return facing;
    result_.has_plane = true;
    return OnPlane(scene, planes[support].normal, planes[support].offset);
  }

  void Export() {
    const CalibratedScene& scene = adjusted_->scene;
    const SimilarityTransform world_from_scene = WorldFromScene();
    const std::vector<ViewCount> counts = CountViews(tracks_, *adjusted_);
    for (size_t v = 0; v < scene.views.size(); ++v) {
      if (!scene.views[v]) {
        if (result_.view_refusals[v].empty())
          result_.view_refusals[v] = "shares too little texture with the other views";
        continue;
      }
      result_.views[v] = Moved(*scene.views[v], world_from_scene);
      result_.view_refusals[v].clear();
      result_.view_matches[v] = {MatchSource::kTexture,
                                 counts[v].agree,
                                 std::sqrt(counts[v].squared_px / std::max(1, counts[v].agree))};
    }
    std::vector<ReconstructedPoint> points(tracks_.points);
    for (size_t k = 0; k < tracks_.point_observations.size(); ++k) {
      const PointObservation& o = tracks_.point_observations[k];
      if (!adjusted_->inliers.point_inlier[k] || !scene.views[o.view]) continue;
      points[o.point].observations.emplace_back(o.view, -1);
      points[o.point].pixels.push_back(o.pixel);
    }
    for (int j = 0; j < tracks_.points; ++j) {
      if (!scene.points[j] || points[j].observations.size() < 2) continue;
      points[j].point_in_world = world_from_scene * *scene.points[j];
      points[j].on_plane =
          result_.has_plane && std::abs(points[j].point_in_world.z()) <= options_.plane_tolerance;
      result_.points.push_back(std::move(points[j]));
    }
    result_.rms_px = adjusted_->summary.rms_px;
    result_.counts["views"] = RegisteredViews(scene.views);
    result_.counts["texture_one_camera"] = one_camera_;
    result_.counts["texture_points_in_space"] = static_cast<double>(result_.points.size());
  }

  const TextureMatching& texture_;
  std::span<const ViewPrior> priors_;
  const TextureRouteOptions& options_;
  const StopRequested& stop_;
  const MultiviewTracks tracks_;
  const TrackIndex index_;
  std::vector<int> camera_of_view_;
  bool one_camera_ = false;
  bool each_is_better_ = false;  // a lens for each image explains more than scenes may differ by
  double cost_ = 0.0;            // UnexplainedCost of the chosen scene
  double spread_ = 0.0;          // of log f among scenes that are one solution
  double other_spread_ = 0.0;    // ... and to other solutions
  std::optional<Alternative> alternative_;
  std::optional<AdjustedTexture> adjusted_;
  Reconstruction result_;
};

}  // namespace

namespace {

absl::Status CheckInput(const TextureMatching& texture,
                        std::span<const ImageSize> sizes,
                        std::span<const ViewPrior> priors) {
  if (texture.keypoints.size() != sizes.size() || texture.sigma_px.size() != sizes.size()) {
    return absl::InvalidArgumentError("reconstruction: " + std::to_string(sizes.size()) +
                                      " sizes and texture of " +
                                      std::to_string(texture.keypoints.size()) + " views");
  }
  HOROPTER_RETURN_IF_ERROR(Validate(priors, sizes.size()));
  if (sizes.size() > kMaxViews) {
    return absl::InvalidArgumentError("reconstruction: " + std::to_string(sizes.size()) +
                                      " views, at most " + std::to_string(kMaxViews));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Reconstruction> ReconstructFromTexture(const TextureMatching& texture,
                                                      std::span<const ImageSize> sizes,
                                                      std::span<const ViewPrior> priors,
                                                      const TextureRouteOptions& options,
                                                      const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(texture, sizes, priors));
  HOROPTER_ASSIGN_OR_RETURN(auto solutions,
                            TextureRoute(texture, sizes, priors, options, stop).Run(false));
  return std::move(solutions.front());
}

absl::StatusOr<std::vector<Reconstruction>> SolutionsOfTexture(const TextureMatching& texture,
                                                               std::span<const ImageSize> sizes,
                                                               std::span<const ViewPrior> priors,
                                                               const TextureRouteOptions& options,
                                                               const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(texture, sizes, priors));
  return TextureRoute(texture, sizes, priors, options, stop).Run(true);
}

}  // namespace horopter
