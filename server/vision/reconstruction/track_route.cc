#include "server/vision/reconstruction/track_route.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "server/base/status_macros.h"
#include "server/vision/reconstruction/scene_frame.h"
#include "server/vision/reconstruction/self_calibration.h"

namespace horopter {
namespace {

constexpr double kMinSigma = 0.8;  // rms that a projective scene is taken to have at least
// Cameras whose focal lengths are known worse than this are not given even untrusted: a search for
// parts that starts from them finds wrong ones (train 13, 33 %: nothing right any more; train 4, 18
// %: right).
constexpr double kMaxGivenFocalSigma = 0.2;

SelfCalibrationOptions CalibrationOptions(const ReconstructionOptions& options) {
  SelfCalibrationOptions out = options.calibration;
  out.bundle.focal_prior_widths = options.focal_prior_widths;
  out.bundle.focal_prior_log_sigma = options.focal_prior_log_sigma;
  return out;
}

// Cameras that may be given: metric, or open in their focal lengths only.
bool HasCameras(const TracksResult& result, double max_rms_ratio) {
  const MetricOutcome outcome = result.metric.outcome;
  const bool open =
      outcome == MetricOutcome::kCriticalMotion || outcome == MetricOutcome::kAmbiguous;
  const double limit = max_rms_ratio * std::max(kMinSigma, result.projective.summary.rms_sigma);
  return outcome == MetricOutcome::kMetric ||
         (open && result.metric.covariance && result.metric.rms_sigma <= limit &&
          result.metric.worst_focal_log_sigma <= kMaxGivenFocalSigma);
}

std::string Refusal(const TracksResult& result) {
  const bool projective = result.projective.outcome == ProjectiveOutcome::kReconstructed;
  return projective ? result.metric.reason : result.projective.reason;
}

void ExportTracks(const MatchedTracks& matched, const TracksResult& from, Reconstruction* result) {
  const CalibratedScene& scene = from.metric.scene;
  const SimilarityTransform world_from_scene = FacingTheCameras(scene);
  double sigma = 0.0;
  int registered = 0;
  for (size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    result->views[v] = Moved(*scene.views[v], world_from_scene);
    sigma = std::max(sigma, scene.views[v]->focal_log_sigma);
    ++registered;
  }
  std::vector<ReconstructedPoint> points(matched.points.size());
  const std::vector<PointObservation>& observations = matched.tracks.point_observations;
  for (size_t k = 0; k < observations.size(); ++k) {
    if (!from.projective.scene.point_inlier[k] || !scene.views[observations[k].view]) continue;
    for (const FeatureTrack::Feature& f : matched.points[observations[k].point].features) {
      if (f.view == observations[k].view) {
        points[observations[k].point].observations.emplace_back(f.view, f.feature);
      }
    }
  }
  for (size_t j = 0; j < points.size(); ++j) {
    if (!scene.points[j] || points[j].observations.size() < 2) continue;
    points[j].point_in_world = world_from_scene * *scene.points[j];
    result->points.push_back(std::move(points[j]));
  }
  result->rms_px = from.metric.rms_px;
  result->counts["points_off_plane"] = static_cast<double>(result->points.size());
  result->counts["views"] = registered;
  result->counts["focal_log_sigma"] = sigma;
}

}  // namespace

absl::StatusOr<Reconstruction> ReconstructFromTracks(const MatchingResult& matching,
                                                     std::span<const ImageFeatures> features,
                                                     std::span<const ImageSize> sizes,
                                                     std::span<const ViewPrior> priors,
                                                     const ReconstructionOptions& options,
                                                     const StopRequested& stop) {
  Reconstruction result;
  result.views.resize(sizes.size());
  GrowOptions grow = options.tracks;
  grow.seed = options.seed;
  grow.min_views = std::max(2, options.min_views);
  const SelfCalibrationOptions calibration = CalibrationOptions(options);
  // Few sure matches or many unsure ones: wrong ones may spoil the second, too few the first.
  for (const MatchedPairs pairs : {MatchedPairs::kAll, MatchedPairs::kWithEpipolarGeometry}) {
    const MatchedTracks matched = TracksOfMatches(matching, pairs, features, sizes);
    if (matched.tracks.points + matched.tracks.lines == 0) continue;
    HOROPTER_ASSIGN_OR_RETURN(const TracksResult found,
                              ReconstructTracks(matched.tracks, priors, grow, calibration, stop));
    if (result.refusal.empty()) result.refusal = Refusal(found);
    if (!HasCameras(found, calibration.max_rms_ratio)) continue;
    result.counts["junction_tracks"] = matched.tracks.points;
    result.counts["segment_tracks"] = matched.tracks.lines;
    result.refusal = Refusal(found);
    ExportTracks(matched, found, &result);
    if (result.refusal.empty() && !(result.rms_px <= options.max_rms_px)) {
      result.refusal = "rms " + std::to_string(result.rms_px) + " px, need " +
                       std::to_string(options.max_rms_px) + " px";
    }
    result.trusted = result.refusal.empty();
    return result;
  }
  if (result.refusal.empty()) result.refusal = "no feature is matched in two views";
  return result;
}

}  // namespace horopter
