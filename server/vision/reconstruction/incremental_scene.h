// Incremental Euclidean reconstruction of points: two views, then view by view, with the focal
// length unknown (Snavely et al. 2006; Schoenberger, Frahm 2016). Beside the projective way of the
// thesis (grow_projective.h), which knows nothing of cameras: before scenes that are nearly a
// plane, and with images of one camera, what is known of cameras is most of what there is to know.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/reconstruction/calibrated_bundle.h"
#include "server/vision/reconstruction/multiview_tracks.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

// Two views that share points, and how many of them one homography explains.
struct SharedPoints {
  int view_a = -1;
  int view_b = -1;
  int points = 0;
  int on_homography = 0;
};

struct IncrementalScene {
  CalibratedScene scene;    // one of its cameras is the frame
  ProjectiveScene inliers;  // its marks: observations that agree
  CalibratedBundleSummary summary;
  double cost = 0.0;  // UnexplainedCost
  int views = 0;
  std::vector<int> camera_of_view;  // as given, with new numbers for views that have a lens apart
};

// Squared residuals in sigmas over all point observations, each bounded by outlier_chi2, which is
// also what one costs that nothing explains.
double UnexplainedCost(const MultiviewTracks& tracks,
                       const CalibratedScene& scene,
                       double outlier_chi2);

// Scenes from several starts (pairs of views, focal lengths), the cheapest first; one of each kind:
// where no focal length differs by a tenth they are one. Empty: no start came to anything.
// tracks: points in pixels. pairs: any order. camera_of_view: per view which camera took it, as far
// as is known (one number for all: one camera); what cannot be registered with its camera's focal
// length gets its own. Errors: INVALID_ARGUMENT (tracks, priors), CANCELLED.
absl::StatusOr<std::vector<IncrementalScene>> ReconstructIncrementally(
    const MultiviewTracks& tracks,
    std::span<const SharedPoints> pairs,
    std::span<const ViewPrior> priors,
    const std::vector<int>& camera_of_view,
    const IncrementalOptions& options,
    const StopRequested& stop = {});

}  // namespace horopter
