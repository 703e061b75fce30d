// Matches of ellipses against the circles of the true parts.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/matching/conic_matching.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

struct ConicFinding {
  // Of which the truth is known: one of the arcs at least is within 2 px of a part's circle, and
  // both must be of one; else the images' poses are known in one world, and one circle must fit
  // both arcs under the true cameras.
  int matches = 0;
  int matches_right = 0;
  int shared = 0;          // circles of parts with arcs in two neighbouring views
  int shared_matched = 0;  // ... that were matched with each other
  int tracked = 0;         // circles of parts in tracks of three views and more, each once
  int in_space = 0;        // conics in space, of parts or not
};

// off_px: how far the truth itself is off.
ConicFinding CompareConics(const ConicMatching& matching,
                           const std::vector<ImageFeatures>& features,
                           const BopScene& scene,
                           const TrueModels& models,
                           double off_px);

}  // namespace horopter
