// Which observations a bundle of points and lines uses, in the order its solver wants.
#pragma once

#include <vector>

#include "server/vision/reconstruction/bundle_solver.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

// Features of the layout: the tracks' points, then their lines; unused ones have no observations.
// Cameras of the layout: the views that are used, ascending.
struct BundleObservations {
  BundleLayout layout;
  std::vector<int> view;         // per camera of the layout
  std::vector<int> observation;  // per observation of the layout: index in its kind's list
  int points = 0;                // features below this are points
};

// Known features and cameras, one entry per feature or view of the tracks.
struct KnownScene {
  std::vector<bool> views, points, lines;
};

// Inlier observations of points in two and of lines in three known views: two views of a line
// always agree. inliers: only its marks are read.
BundleObservations SelectObservations(const MultiviewTracks& tracks,
                                      const ProjectiveScene& inliers,
                                      const KnownScene& known);

}  // namespace horopter
