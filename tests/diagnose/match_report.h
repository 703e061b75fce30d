// Junction matches against the true epipolar geometry and the true corners.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/matching/matching.h"
#include "tests/diagnose/feature_report.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

struct MatchFinding {
  int matches = 0;
  int matches_right = 0;    // both points within 2 px of the true epipolar line of the other
  int shared_corners = 0;   // true corners seen in two neighbouring views
  int corners_matched = 0;  // ... whose junctions were matched with each other
};

MatchFinding CompareMatches(const MatchingResult& matching,
                            const BopScene& scene,
                            const std::vector<ImageFeatures>& features,
                            const std::vector<TrueView>& truth);

}  // namespace horopter
