// How much of the true edges and corners of one view the features stage found.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

struct EdgeFinding {
  double covered =
      0.0;  // share of the visible samples within 2 px and 5 degrees of a segment or arc
  double covered_by_arcs = 0.0;  // the same by arcs alone
  double covered_usable = 0.0;   // the same by arcs and the segments that are not marked as texture
  int pieces = 0;                // segments and arcs that cover at least 4 samples
};

struct FeatureFinding {
  std::vector<EdgeFinding> edges;       // one per TrueView::edges
  std::vector<double> corner_error_px;  // one per TrueView::corners: nearest junction
  std::vector<int> nearest_junction;    // its index, -1: none in the image
  int segments = 0;
  int segments_in_texture = 0;
};

// An edge counts as found when at least this share of it is covered.
constexpr double kFoundEdgeShare = 0.7;
// A corner counts as found when a junction lies this near.
constexpr double kCornerPx = 3.0;

FeatureFinding CompareFeatures(const ImageFeatures& features, const TrueView& truth);

}  // namespace horopter
