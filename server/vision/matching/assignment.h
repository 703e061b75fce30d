// One-to-one assignment of candidate matches that support each other: approximate solutions of the
// quadratic assignment problem over a sparse set of candidates (thesis 2.7.4).
#pragma once

#include <vector>

#include "server/vision/matching/matching_options.h"

namespace horopter {

// Candidates are numbered 0 .. n-1. Two candidates of one row, or of one column, exclude each
// other.
struct AssignmentProblem {
  std::vector<int> row;          // per candidate; rows are numbered from 0
  std::vector<int> column;       // ... and columns
  std::vector<float> self;       // >= 0: what speaks for a candidate alone
  std::vector<int> begin = {0};  // links of candidate i: begin[i] .. begin[i + 1]
  std::vector<int> to;           // linked candidate; links are stored at both ends
  std::vector<float> weight;     // >= 0: how much the two support each other

  int size() const { return static_cast<int>(row.size()); }
};

// Confidence of every candidate, >= 0, largest 1 (all 0 for an empty problem).
std::vector<double> Confidences(const AssignmentProblem& problem, const AssignmentOptions& options);

// Candidates taken best first, none twice in a row or column; those of confidence 0 never. Ties are
// broken by number, so the result is the same everywhere.
std::vector<int> Discretize(const AssignmentProblem& problem,
                            const std::vector<double>& confidences);

}  // namespace horopter
