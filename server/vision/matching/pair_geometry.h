// Junction matches and epipolar geometry of one pair of views.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/matching/plane_parallax.h"

namespace horopter {

// What one view brings to pair matching.
struct JunctionView {
  const cv::Mat* image = nullptr;
  const ImageFeatures* features = nullptr;
};

struct CandidateOptions {
  double max_parallax_widths =
      0.25;  // displacement against the plane (or the image, without a plane), image widths
  double min_likeness = 0.5;
  int per_junction = 3;  // kept per junction, in both directions
};

// Candidate matches, patches of view b laid out by the plane's local affinity when b_from_a is
// given.
std::vector<MatchCandidate> FindCandidates(const JunctionView& a,
                                           const JunctionView& b,
                                           const std::optional<Eigen::Matrix3d>& b_from_a,
                                           const CandidateOptions& options);

// With the plane known: plane + parallax. Without: a robust F on mutually best junctions, refused
// when one homography explains its inliers.
PairGeometry EstimatePairGeometry(int view_a,
                                  int view_b,
                                  const JunctionView& a,
                                  const JunctionView& b,
                                  const std::optional<Eigen::Matrix3d>& b_from_a,
                                  const MatchingOptions& options);

}  // namespace horopter
