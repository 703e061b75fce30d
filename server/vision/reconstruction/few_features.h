// A calibrated scene on few of its features, for adjustments that only have to tell minima apart.
#pragma once

#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

// The views with so many points and lines that each has `of_view` inlier observations, or all it
// has; features spread over the tracks. inliers: its marks are read.
CalibratedScene OnFewFeatures(const MultiviewTracks& tracks,
                              const ProjectiveScene& inliers,
                              int of_view,
                              const CalibratedScene& scene);

// Triangulates the features that the projective scene knows and `scene` does not, from their inlier
// observations in the cameras of `scene` (without their lenses). What cannot be stays unknown.
void TriangulateOthers(const MultiviewTracks& tracks,
                       const ProjectiveScene& projective,
                       CalibratedScene* scene);

}  // namespace horopter
