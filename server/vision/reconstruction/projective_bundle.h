// Robust projective bundle adjustment of cameras, points and lines.
#pragma once

#include "server/vision/reconstruction/bundle_covariance.h"
#include "server/vision/reconstruction/multiview_tracks.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/robust_loss.h"

namespace horopter {

struct ProjectiveBundleSummary {
  bool usable = false;
  double cost = 0.0;
  int iterations = 0;
};

// Minimises the robust reprojection error of all inlier observations over 11 parameters per camera,
// 3 per point, 4 per line; the gauge is free, which Levenberg-Marquardt's damping takes care of.
// Any coordinates; normalised ones condition it. Features with one observation stay as they are.
// The scene is left unchanged when the solver fails.
ProjectiveBundleSummary AdjustProjective(const MultiviewTracks& tracks,
                                         const ProjectiveBundleOptions& options,
                                         ProjectiveScene* scene);

// Covariance of the scene up to a collineation, for observations of the stated sigmas. Nullopt when
// the scene has no redundancy or the solver fails. Features that are not in it have tangent size 0.
std::optional<BundleCovariance> ProjectiveCovariance(const MultiviewTracks& tracks,
                                                     const ProjectiveScene& scene);

// Covariances of the finite points H X after the collineation that aligns all of them best in the
// least-squares sense has taken its share: what remains when the scene is compared with the truth
// that way. H leads to a metric frame. One 3 x 3 matrix per point, in units of that frame; zero
// where a point is unknown.
std::vector<Eigen::Matrix3d> AlignedPointCovariances(const BundleCovariance& covariance,
                                                     const ProjectiveScene& scene,
                                                     const Eigen::Matrix4d& H);

}  // namespace horopter
