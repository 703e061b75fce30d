// One view prepared for feature matching: its features, their graph, and what the image shows
// beside them. Made once per view, used in every pair (thesis 2.7).
#pragma once

#include <Eigen/Core>
#include <array>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/features/feature_graph.h"
#include "server/vision/features/features.h"
#include "server/vision/matching/junction_patches.h"

namespace horopter {

// Grey values beside a segment, on one side: 12 places along it, 3 rows of growing distance (2 to
// 8 px), so that length and direction are normalised away. Zero mean, unit norm unless flat.
struct SideStrip {
  static constexpr int kAlong = 12;  // samples along the segment
  static constexpr int kRows = 3;    // distances from it
  using Vector = Eigen::Matrix<float, kAlong * kRows, 1>;
  Vector values = Vector::Zero();
  bool flat = true;  // less structure than noise has: correlates with nothing
};

struct MatchingView {
  const ImageFeatures* features = nullptr;
  FeatureGraph graph;
  std::vector<std::array<SideStrip, 2>> strips;  // per segment: left, right of start -> end
  std::vector<JunctionPatch> patches;            // per junction, upright
  cv::Mat smooth;                                // the image, see SmoothForPatches
};

// image: CV_8UC1 or CV_8UC3, the one the features were found in. The view refers to `features`.
MatchingView PrepareMatchingView(const cv::Mat& image,
                                 const ImageFeatures& features,
                                 const FeatureGraphOptions& options = {});

// Correlation of two strips in [-1, 1], the second one walked backwards when `reversed`;
// nullopt-like NaN when either is flat.
float StripCorrelation(const SideStrip& a, const SideStrip& b, bool reversed);

}  // namespace horopter
