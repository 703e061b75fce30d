// Feature matches and epipolar geometry of one pair of views: similarity and neighbourhood give
// matches, the matches a geometry, the geometry better matches (thesis 2.7, frontend study).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/matching/matching_view.h"

namespace horopter {

// Matches by similarity and neighbourhood alone; no F.
PairGeometry MatchPair(int view_a,
                       int view_b,
                       const MatchingView& a,
                       const MatchingView& b,
                       const std::optional<Eigen::Matrix3d>& b_from_a,
                       const FeatureMatchOptions& options = {});

// Sets F from the pair's matches, or the refusal. With the plane known: plane + parallax and a free
// F, chosen by how many of the matches they explain. Without: a free F, refused when one homography
// explains its inliers, when no pair of plausible cameras has it, or when segments that took no
// part in it contradict it.
void EstimateEpipolarGeometry(const MatchingView& a,
                              const MatchingView& b,
                              const std::optional<Eigen::Matrix3d>& b_from_a,
                              const MatchingOptions& options,
                              PairGeometry* pair);

// Whether plausible cameras can have F (strain, see robust_fundamental.h).
bool HasPlausibleCameras(const Eigen::Matrix3d& F, const MatchingView& a, const MatchingView& b);

// Matches along the epipolar lines of a known F: of an accepted pair, of cameras already
// reconstructed, or of a recognised part (the second pass). pair.F must be set; its matches and
// segments are replaced.
void MatchAlongEpipolarLines(const MatchingView& a,
                             const MatchingView& b,
                             const std::optional<Eigen::Matrix3d>& b_from_a,
                             PairGeometry* pair,
                             const FeatureMatchOptions& options = {});

}  // namespace horopter
