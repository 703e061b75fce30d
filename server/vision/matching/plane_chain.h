// Pairwise plane homographies joined into one plane map per view.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "server/vision/matching/matching.h"

namespace horopter {

struct PlaneChain {
  std::vector<int> component;  // per view, -1: no accepted plane touches it
  std::vector<Eigen::Matrix3d>
      view_from_plane;  // the plane's coordinates are the pixels of the component's first view
  std::vector<bool> consistent;  // per input homography: agrees with the chain within max_px
  int contradicted = 0;          // homographies that do not
  double rms_px = 0.0;           // forward transfer error of the agreeing ones after refinement
};

// Triples of indices of homographies between three views whose composition agrees within max_px
// (median transfer error of the first one's inliers).
std::vector<std::array<size_t, 3>> ClosedTriangles(std::span<const PlaneHomography> planes,
                                                   double max_px);

// Joins the homographies along the spanning tree of most inliers, removes those that contradict it
// (median transfer error of their inliers above max_px), and refines all views together on the
// inliers of the rest. Links that close no loop cannot be checked and are kept.
PlaneChain ChainPlanes(std::span<const PlaneHomography> planes, int views, double max_px);

}  // namespace horopter
