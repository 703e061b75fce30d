#include "server/vision/reconstruction/self_calibration.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/vision/reconstruction/calibration_starts.h"
#include "server/vision/reconstruction/chirality.h"
#include "server/vision/reconstruction/few_features.h"
#include "server/vision/reconstruction/pose_alignment.h"
#include "server/vision/reconstruction/scene_views.h"

namespace horopter {
namespace {

constexpr double kDistinctLogFocal = 0.1;  // log of the ratio; nearer solutions are one
constexpr double kMinInFront = 0.9;        // share of points before the cameras in a start
// Observations of a view and sweeps that show which minimum a start ends in.
constexpr int kFewOfView = 40;
constexpr int kFewIterations = 12;

struct Candidate {
  CalibratedScene scene;
  int dropped = 0;  // views that saw it mirrored
  CalibratedBundleSummary summary;
};

bool SameCalibration(const CalibratedScene& a, const CalibratedScene& b) {
  return LargestFocalDifference(a.views, b.views) <= kDistinctLogFocal;
}

double WorstFocalSigma(const CalibratedScene& scene) {
  double worst = 0.0;
  for (const auto& view : scene.views) {
    if (view) worst = std::max(worst, view->focal_log_sigma);
  }
  return worst;
}

// Share of the points in front of all cameras that see them.
double InFront(const MultiviewTracks& tracks,
               const ProjectiveScene& inliers,
               const CalibratedScene& scene) {
  int front = 0, all = 0;
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    if (!inliers.point_inlier[k] || !scene.views[o.view] || !scene.points[o.point]) continue;
    ++all;
    front += (scene.views[o.view]->camera_from_scene * *scene.points[o.point]).z() > 0.0;
  }
  return all > 0 ? static_cast<double>(front) / all : 0.0;
}

// Takes out views with most of their points behind them: with square pixels and a proper rotation
// only a mirrored image does that while the others are right. Returns how many.
int DropMirroredViews(const MultiviewTracks& tracks,
                      const ProjectiveScene& inliers,
                      CalibratedScene* scene) {
  std::vector<int> front(scene->views.size(), 0), all(scene->views.size(), 0);
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    if (!inliers.point_inlier[k] || !scene->views[o.view] || !scene->points[o.point]) continue;
    ++all[o.view];
    front[o.view] += (scene->views[o.view]->camera_from_scene * *scene->points[o.point]).z() > 0.0;
  }
  int dropped = 0;
  for (size_t v = 0; v < scene->views.size(); ++v) {
    if (!scene->views[v] || all[v] == 0 || 5 * front[v] > all[v]) continue;
    scene->views[v].reset();
    ++dropped;
  }
  return dropped;
}

void Decide(const MultiviewTracks& tracks,
            const ProjectiveScene& projective,
            const SelfCalibrationOptions& options,
            MetricResult* result) {
  const double projective_sigma = Summarize(tracks, projective).rms_sigma;
  // More freedom fits noise better: below one sigma the ratio means nothing.
  const double limit = options.max_rms_ratio * std::max(projective_sigma, 0.8);
  bool bounded = true;
  for (size_t v = 0; v < result->scene.views.size(); ++v) {
    if (!result->scene.views[v]) continue;
    const double widths = result->scene.views[v]->camera.focal_px / tracks.sizes[v].width;
    bounded = bounded && widths >= options.min_focal_widths && widths <= options.max_focal_widths;
  }
  if (!result->covariance) {
    result->outcome = MetricOutcome::kCriticalMotion;
    result->reason = "the covariance of the calibration cannot be computed";
  } else if (!(result->worst_focal_log_sigma <= options.max_focal_log_sigma)) {
    result->outcome = MetricOutcome::kCriticalMotion;
    result->reason = absl::StrFormat("focal length known to %.0f %%, need %.0f %%",
                                     100.0 * std::min(result->worst_focal_log_sigma, 10.0),
                                     100.0 * options.max_focal_log_sigma);
  } else if (!(result->rms_sigma <= limit)) {
    result->outcome = MetricOutcome::kCameraModel;
    result->reason = absl::StrFormat(
        "rms %.2f sigma, the projective scene has %.2f", result->rms_sigma, projective_sigma);
  } else if (!bounded) {
    result->outcome = MetricOutcome::kCameraModel;
    result->reason = absl::StrFormat("a focal length outside %.1f..%.1f image widths",
                                     options.min_focal_widths,
                                     options.max_focal_widths);
  } else if (InFront(tracks, projective, result->scene) < 0.99) {
    result->outcome = MetricOutcome::kCameraModel;
    result->reason = "points behind the cameras";
  } else if (result->alternative_gap < options.min_alternative_gap) {
    result->outcome = MetricOutcome::kAmbiguous;
    result->reason =
        absl::StrFormat("a different calibration is worse by chi^2 %.1f only, need %.1f",
                        result->alternative_gap,
                        options.min_alternative_gap);
  } else {
    result->outcome = MetricOutcome::kMetric;
  }
}

bool IsSceneOf(const MultiviewTracks& tracks, const ProjectiveScene& projective) {
  return projective.cameras.size() == tracks.sizes.size() &&
         static_cast<int>(projective.points.size()) == tracks.points &&
         static_cast<int>(projective.lines.size()) == tracks.lines &&
         projective.point_inlier.size() == tracks.point_observations.size() &&
         projective.line_inlier.size() == tracks.line_observations.size();
}

// Chi^2 by which the best calibration that is another than the first is worse; infinite without
// one.
double AlternativeGap(const std::vector<Candidate>& found) {
  for (size_t k = 1; k < found.size(); ++k) {
    if (found[k].dropped != found[0].dropped || SameCalibration(found[0].scene, found[k].scene)) {
      continue;
    }
    return 2.0 * (found[k].summary.cost - found[0].summary.cost);
  }
  return std::numeric_limits<double>::infinity();
}

void SortCandidates(std::vector<Candidate>* found) {
  std::stable_sort(found->begin(), found->end(), [](const Candidate& x, const Candidate& y) {
    if (x.dropped != y.dropped) return x.dropped < y.dropped;
    return x.summary.cost < y.summary.cost;
  });
}

// The minima that the starts end in, adjusted on few features, in the order of SortCandidates.
// cameras: in the scene; starts: counts those tried. Errors: CANCELLED.
absl::StatusOr<std::vector<Candidate>> Minima(const MultiviewTracks& tracks,
                                              const ProjectiveScene& scene,
                                              std::span<const ViewPrior> priors,
                                              int cameras,
                                              const SelfCalibrationOptions& options,
                                              const StopRequested& stop,
                                              int* starts) {
  CalibratedBundleOptions rough = options.bundle;
  rough.loss = RobustLoss::kCauchy;
  rough.max_iterations = std::min(kFewIterations, rough.max_iterations);
  std::vector<Candidate> found;
  for (const CalibratedScene& start : FindCalibrationStarts(tracks, scene, priors, options)) {
    if (IsStopRequested(stop)) return absl::CancelledError("self-calibration: cancelled");
    ++*starts;
    Candidate candidate{start, 0, {}};
    candidate.dropped = DropMirroredViews(tracks, scene, &candidate.scene);
    if (3 * candidate.dropped > cameras) continue;
    AlignToPoses(priors, &candidate.scene);
    CalibratedScene few = OnFewFeatures(tracks, scene, kFewOfView, candidate.scene);
    candidate.summary = AdjustCalibrated(tracks, scene, priors, rough, &few);
    if (!candidate.summary.usable) continue;
    candidate.scene = std::move(few);
    found.push_back(std::move(candidate));
  }
  SortCandidates(&found);
  std::vector<Candidate> distinct;
  for (Candidate& candidate : found) {
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const Candidate& other) {
      return other.dropped == candidate.dropped && SameCalibration(other.scene, candidate.scene);
    });
    if (!known) distinct.push_back(std::move(candidate));
  }
  return distinct;
}

// The minima that fit when they are adjusted on everything, those with fewest mirrored views first,
// then cheapest first. Errors: CANCELLED.
absl::StatusOr<std::vector<Candidate>> PlausibleCalibrations(const MultiviewTracks& tracks,
                                                             const ProjectiveScene& scene,
                                                             std::span<const ViewPrior> priors,
                                                             const SelfCalibrationOptions& options,
                                                             const StopRequested& stop,
                                                             std::vector<Candidate> minima) {
  CalibratedBundleOptions bundle = options.bundle;
  bundle.loss = RobustLoss::kCauchy;
  std::vector<Candidate> found;
  for (Candidate& candidate : minima) {
    TriangulateOthers(tracks, scene, &candidate.scene);
    if (IsStopRequested(stop)) return absl::CancelledError("self-calibration: cancelled");
    candidate.summary = AdjustCalibrated(tracks, scene, priors, bundle, &candidate.scene);
    if (!candidate.summary.usable) continue;
    if (InFront(tracks, scene, candidate.scene) < kMinInFront) continue;
    found.push_back(std::move(candidate));
  }
  SortCandidates(&found);
  return found;
}

}  // namespace

absl::Status Validate(const SelfCalibrationOptions& options) {
  if (!(options.min_focal_widths > 0.0) || !(options.max_focal_widths > options.min_focal_widths)) {
    return absl::InvalidArgumentError("focal widths: need 0 < min < max");
  }
  if (options.focal_steps < 2 || options.focal_steps > 100 || options.max_starts < 1 ||
      options.max_pairs < 1) {
    return absl::InvalidArgumentError("focal_steps: 2..100; max_starts, max_pairs: at least 1");
  }
  if (!(options.max_focal_log_sigma > 0.0) || !(options.max_rms_ratio >= 1.0)) {
    return absl::InvalidArgumentError("max_focal_log_sigma > 0 and max_rms_ratio >= 1 needed");
  }
  const CalibratedBundleOptions& b = options.bundle;
  if (!(b.focal_prior_widths > 0.0) || !(b.focal_prior_log_sigma > 0.0) ||
      !(b.principal_point_sigma_widths > 0.0) || !(b.k1_sigma > 0.0)) {
    return absl::InvalidArgumentError("bundle: priors need positive deviations");
  }
  return absl::OkStatus();
}

absl::StatusOr<MetricResult> SelfCalibrate(const MultiviewTracks& tracks,
                                           const ProjectiveScene& projective,
                                           std::span<const ViewPrior> priors,
                                           const SelfCalibrationOptions& options,
                                           const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  HOROPTER_RETURN_IF_ERROR(Validate(tracks));
  HOROPTER_RETURN_IF_ERROR(Validate(priors, tracks.sizes.size()));
  if (!IsSceneOf(tracks, projective)) {
    return absl::InvalidArgumentError("projective: not a scene of these tracks");
  }
  MetricResult result;
  result.scene.views.resize(tracks.sizes.size());
  result.scene.points.resize(tracks.points);
  result.scene.lines.resize(tracks.lines);
  result.mirrored.assign(tracks.sizes.size(), false);
  result.alternative_gap = std::numeric_limits<double>::infinity();
  LeaveIfStopped();
  const auto frame = FindQuasiAffineFrame(tracks, projective);
  LeaveIfStopped();
  if (!frame) {
    result.outcome = MetricOutcome::kNoQuasiAffine;
    result.reason = "no plane at infinity leaves points and cameras on one side";
    return result;
  }
  ProjectiveScene scene = projective;
  int cameras = 0;
  for (size_t v = 0; v < scene.cameras.size(); ++v) {
    if (!scene.cameras[v]) continue;
    result.mirrored[v] = !frame->camera_consistent[v];
    if (result.mirrored[v]) scene.cameras[v].reset();
    cameras += scene.cameras[v].has_value();
  }
  for (int j = 0; j < tracks.points; ++j) {
    if (!frame->point_consistent[j]) scene.points[j].reset();
  }
  HOROPTER_ASSIGN_OR_RETURN(std::vector<Candidate> minima,
                            Minima(tracks, scene, priors, cameras, options, stop, &result.starts));
  HOROPTER_ASSIGN_OR_RETURN(
      std::vector<Candidate> found,
      PlausibleCalibrations(tracks, scene, priors, options, stop, std::move(minima)));
  if (found.empty()) {
    result.outcome = MetricOutcome::kCameraModel;
    result.reason = absl::StrFormat("no plausible cameras fit %d views", cameras);
    return result;
  }
  result.alternative_gap = AlternativeGap(found);
  CalibratedBundleOptions last = options.bundle;
  last.loss = RobustLoss::kTukey;
  last.covariance = true;
  result.scene = std::move(found[0].scene);
  for (size_t v = 0; v < scene.cameras.size(); ++v) {
    if (scene.cameras[v] && !result.scene.views[v]) result.mirrored[v] = true;
  }
  CalibratedBundleSummary summary = AdjustCalibrated(tracks, scene, priors, last, &result.scene);
  if (!summary.usable) summary = found[0].summary;
  result.rms_px = summary.rms_px;
  result.rms_sigma = summary.rms_sigma;
  result.covariance = std::move(summary.covariance);
  result.worst_focal_log_sigma = WorstFocalSigma(result.scene);
  if (result.covariance) result.weakest_deviation = result.covariance->WeakestDeviation();
  Decide(tracks, scene, options, &result);
  return result;
}

absl::StatusOr<TracksResult> ReconstructTracks(const MultiviewTracks& tracks,
                                               std::span<const ViewPrior> priors,
                                               const GrowOptions& grow,
                                               const SelfCalibrationOptions& calibration,
                                               const StopRequested& stop) {
  TracksResult result;
  HOROPTER_ASSIGN_OR_RETURN(result.projective, ReconstructProjective(tracks, grow, stop));
  if (result.projective.outcome != ProjectiveOutcome::kReconstructed) {
    result.metric.reason = result.projective.reason;
    result.metric.scene.views.resize(tracks.sizes.size());
    result.metric.scene.points.resize(tracks.points);
    result.metric.scene.lines.resize(tracks.lines);
    result.metric.mirrored.assign(tracks.sizes.size(), false);
    HOROPTER_RETURN_IF_ERROR(Validate(calibration));
    HOROPTER_RETURN_IF_ERROR(Validate(priors, tracks.sizes.size()));
    return result;
  }
  HOROPTER_ASSIGN_OR_RETURN(
      result.metric, SelfCalibrate(tracks, result.projective.scene, priors, calibration, stop));
  return result;
}

}  // namespace horopter
