// Segments and junctions of two views matched with each other: similarity of each candidate,
// support of neighbouring candidates, one-to-one assignment (thesis 2.7).
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/matching/assignment.h"
#include "server/vision/matching/feature_similarity.h"
#include "server/vision/matching/matching_options.h"

namespace horopter {

// A match of two features of one kind. `log_ratio`: of the pair and its accepted neighbours.
struct FeatureMatch {
  FeatureKind kind = FeatureKind::kJunction;  // kSegment or kJunction
  int a = -1;                                 // index into ImageFeatures::segments or ::junctions
  int b = -1;
  double log_ratio = 0.0;
};

// How two candidate matches of neighbouring features may support each other.
enum class MatchRelation {
  kSegmentMeetsJunction,
  kSegmentsShareJunction,
  kSegmentsCollinear,
  kSegmentsParallel,
  kSegmentsSameRegion,
  kJunctionsOfOneSegment,
};
constexpr int kMatchRelationCount = 6;  // of the enumeration above

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const FeatureMatchOptions& options);

// Two candidates and what their neighbourhood says, for learning and for the assignment.
struct MatchCandidateLink {
  int from = -1;
  int to = -1;
  MatchRelation relation = MatchRelation::kSegmentMeetsJunction;
  // Disagreement of the transformations: difference of the turns (rad) of two segments; change of
  // the displacement between two junctions over their distance; 0 where neither applies.
  float disagreement = 0.0f;
};
struct CandidateGraph {
  std::vector<FeatureMatch> candidates;   // log_ratio: of the pair alone
  std::vector<MatchCandidateLink> links;  // each once
};
CandidateGraph BuildCandidateGraph(const PairComparison& pair, const FeatureMatchOptions& options);

// One-to-one matches, junctions first, then segments, by index_a.
std::vector<FeatureMatch> MatchFeatures(const PairComparison& pair,
                                        const FeatureMatchOptions& options);

}  // namespace horopter
