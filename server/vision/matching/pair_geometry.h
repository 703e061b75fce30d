// Feature matches and epipolar geometry of one pair of views: likeness and neighbourhood give
// matches, the matches a geometry, the geometry better matches (thesis 2.7, frontend study).
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/matching/matching_view.h"

namespace horopter {

// What one view brings to pair matching.
struct PairView {
  const cv::Mat* image = nullptr;
  const MatchingView* view = nullptr;
};

// With the plane known: plane + parallax and a free F, chosen by how many of the matches they
// explain. Without: a free F, refused when one homography explains its inliers, when no pair of
// plausible cameras has it, or when segments that took no part in it contradict it. The matches of
// an accepted F are made again along its epipolar lines.
PairGeometry EstimatePairGeometry(int view_a,
                                  int view_b,
                                  const PairView& a,
                                  const PairView& b,
                                  const std::optional<Eigen::Matrix3d>& b_from_a,
                                  const MatchingOptions& options);

// Matches along the epipolar lines of a known F: of an accepted pair, of cameras already
// reconstructed, or of a recognised part (the second pass). pair.F must be set; its matches and
// segments are replaced.
void MatchAlongEpipolarLines(const PairView& a,
                             const PairView& b,
                             const std::optional<Eigen::Matrix3d>& b_from_a,
                             PairGeometry* pair);

}  // namespace horopter
