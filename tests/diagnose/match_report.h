// Junction matches against the true epipolar geometry and the true corners.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/matching/matching.h"
#include "tests/diagnose/feature_report.h"
#include "tests/diagnose/ground_truth.h"
#include "tests/diagnose/true_world.h"

namespace horopter {

// Of the pairs with an F; `matches` of which the truth is known.
struct MatchFinding {
  int matches = 0;
  int matches_right = 0;    // as TrueTransfer judges
  int shared_corners = 0;   // true corners found as junctions in two neighbouring views
  int corners_matched = 0;  // ... whose junctions were matched with each other
  int shared_edges = 0;     // true straight edges found as segments in two neighbouring views
  int edges_matched = 0;    // ... of which segments were matched with each other
  // Per part of the scene: corners and straight edges in tracks of >= 3 views, each once.
  std::vector<int> tracked;
};

// truth: of the world's images.
MatchFinding CompareMatches(const MatchingResult& matching,
                            const TrueWorld& world,
                            const TrueModels& models,
                            const std::vector<ImageFeatures>& features,
                            const std::vector<TrueView>& truth);

}  // namespace horopter
