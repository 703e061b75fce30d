// Metric bundle adjustment of cameras, points and lines with priors on the cameras.
#pragma once

#include <span>

#include "server/vision/reconstruction/bundle_covariance.h"
#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/multiview_tracks.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/robust_loss.h"

namespace horopter {

struct CalibratedBundleSummary {
  bool usable = false;
  double cost = 0.0;       // robust, with the priors
  double rms_sigma = 0.0;  // of the used observations
  double rms_px = 0.0;
  std::optional<BundleCovariance> covariance;
  int camera_tangent =
      0;  // parameters per view in it: rotation 3, translation 3, log f, cx, cy, k1
};

// Minimises the robust reprojection error over the inlier observations (of `inliers`) in place;
// tracks in pixels. priors: one per view or none. Points are homogeneous, lines have four
// parameters; gauge free unless poses are given. Unchanged when the solver fails or something ends
// behind a camera.
CalibratedBundleSummary AdjustCalibrated(const MultiviewTracks& tracks,
                                         const ProjectiveScene& inliers,
                                         std::span<const ViewPrior> priors,
                                         const CalibratedBundleOptions& options,
                                         CalibratedScene* scene);

}  // namespace horopter
