// From a projective scene to a metric one by what is known about cameras: square pixels, no skew, a
// principal point near the centre; each focal length unknown.
#pragma once

#include <map>
#include <span>
#include <string>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/reconstruction/calibrated_bundle.h"
#include "server/vision/reconstruction/grow_projective.h"
#include "server/vision/reconstruction/reconstruction_options.h"

namespace horopter {

enum class MetricOutcome {
  kMetric,
  kNotProjective,   // there was no projective scene to start from
  kNoQuasiAffine,   // no plane at infinity leaves scene and cameras on one side
  kCriticalMotion,  // focal lengths are not determined: rotation, orbit, long focal lengths, few
                    // views
  kCameraModel,     // no plausible camera explains the images as well as a projective one
  kAmbiguous,       // another calibration explains the images nearly as well
};

absl::Status Validate(const SelfCalibrationOptions& options);

struct MetricResult {
  MetricOutcome outcome = MetricOutcome::kNotProjective;
  std::string reason;          // with numbers; empty when metric
  CalibratedScene scene;       // the best one found, also when it is refused
  std::vector<bool> mirrored;  // views that see the scene's mirror image; they are left out
  double rms_px = 0.0;
  double rms_sigma = 0.0;
  double weakest_deviation = 0.0;  // of the camera parameters, from the covariance's spectrum
  double worst_focal_log_sigma = 0.0;
  double alternative_gap =
      0.0;  // chi^2 to the second-best distinct calibration; infinite without one
  int starts = 0;
  std::optional<BundleCovariance> covariance;
};

// projective: cameras in pixels, with its inlier marks. priors: one per view or none. A refusal is
// an outcome, not an error. Errors: INVALID_ARGUMENT (sizes, options, priors), CANCELLED.
absl::StatusOr<MetricResult> SelfCalibrate(const MultiviewTracks& tracks,
                                           const ProjectiveScene& projective,
                                           std::span<const ViewPrior> priors,
                                           const SelfCalibrationOptions& options,
                                           const StopRequested& stop = {});

// Projective, then metric where the images allow it: the projective result stays when they do not.
struct TracksResult {
  ProjectiveResult projective;
  MetricResult metric;
};
absl::StatusOr<TracksResult> ReconstructTracks(const MultiviewTracks& tracks,
                                               std::span<const ViewPrior> priors,
                                               const GrowOptions& grow,
                                               const SelfCalibrationOptions& calibration,
                                               const StopRequested& stop = {});

}  // namespace horopter
