// Incremental projective reconstruction: from the best pair or triple, view by view, so that one
// bad image does not sink the set (thesis 3.3.3).
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/bundle_covariance.h"
#include "server/vision/reconstruction/projective_bundle.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/view_pairs.h"

namespace horopter {

// Where cameras and structure come from first.
enum class ProjectiveOutcome {
  kReconstructed,
  kTooFewViews,
  kTooFewFeatures,
  kNoParallax,    // one homography explains every pair: planar scene, one centre, duplicates
  kInconsistent,  // no start explained enough of the observations
  kUndetermined,  // the observations leave a direction open (covariance)
};

absl::Status Validate(const GrowOptions& options);

struct ProjectiveResult {
  ProjectiveOutcome outcome = ProjectiveOutcome::kInconsistent;
  std::string reason;     // with numbers; empty when reconstructed
  ProjectiveScene scene;  // cameras in pixels; also when undetermined
  ResidualSummary summary;
  int starts = 0;             // tried
  double inlier_share = 0.0;  // of all observations of known features in known cameras
  double weakest_deviation = 0.0;
  int redundancy = 0;  // observations minus parameters
};

// "Not enough" is an outcome, not an error. Errors: INVALID_ARGUMENT (tracks, options), CANCELLED.
absl::StatusOr<ProjectiveResult> ReconstructProjective(const MultiviewTracks& tracks,
                                                       const GrowOptions& options,
                                                       const StopRequested& stop = {});

}  // namespace horopter
