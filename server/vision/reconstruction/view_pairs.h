// Robust epipolar geometry of all pairs of views: the screening that alternation needs, and where
// a reconstruction may start.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/reconstruction_options.h"

namespace horopter {

// Epipolar geometry of two views in the tracks' coordinates.
struct ViewPair {
  int view_a = -1;
  int view_b = -1;
  std::vector<std::array<int, 2>> matches;  // point observations in a and b
  std::vector<bool> inlier;                 // per match
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();
  int inliers = 0;
  // Inliers that no single homography explains; too few mean a plane or a common centre, and then
  // F is one of many.
  int off_homography = 0;
  // Sum over inliers of their distance from the best homography in sigmas, each at most 50: what
  // recommends a pair as a start.
  double parallax = 0.0;
  // Median distance between matched pixels in sigmas: nothing moved in duplicate images.
  double motion = 0.0;
};

// Inliers off the homography that a pair needs before its F is believed: five, and a share of all,
// because before a plane F has two freedoms left and bends to wrong matches.
inline constexpr int kMinOffHomography = 5;
inline constexpr double kMinOffHomographyShare = 0.15;
inline bool HasParallax(const ViewPair& pair) {
  return pair.off_homography >= kMinOffHomography &&
         pair.off_homography >= kMinOffHomographyShare * pair.inliers;
}

// Pairs with at least min_inliers consistent matches, 7-point RANSAC with refits by 8 points.
std::vector<ViewPair> EstimateViewPairs(const MultiviewTracks& tracks,
                                        const TrackIndex& index,
                                        const ViewPairOptions& options,
                                        const StopRequested& stop = {});

// Clears the inlier mark of observations that are outliers in at least half of the pairs with
// parallax they take part in.
void ScreenObservations(const std::vector<ViewPair>& pairs, ProjectiveScene* scene);

}  // namespace horopter
