// Cuts edge chains into pieces that one line or one conic fits: the methods side by side.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/features/chain_curvature.h"
#include "server/vision/features/features.h"
#include "server/vision/features/split_and_merge.h"
#include "server/vision/features/template_splitting.h"

namespace horopter {

struct ChainSplittingOptions {
  ChainSplittingMethod method = ChainSplittingMethod::kSplitAndMerge;
  SplitAndMergeOptions split_and_merge;
  CurvatureOptions curvature;          // of the two curvature methods
  TemplateSplittingOptions templates;  // of kCurvatureTemplates
  double max_curvature = 0.045;        // 1/px, of kCurvatureThreshold; higher: fewer cuts
  int suppression = 8;                 // points, of kCurvatureThreshold
  int min_points = 6;                  // of the two curvature methods: shorter pieces are left out
  // Neighbouring pieces of the two curvature methods are joined again while one line or one ellipse
  // leaves at most this many times what their own leave (rms). 0: never, as in the thesis, which
  // joins fitted features later (2.5). Higher: fewer cuts across smooth curves, weak corners lost.
  double rejoin_factor = 1.3;
  double rejoin_rms_px = 0.4;  // ... and leaves no more than this
  // A piece is curved when the parabola over its line rises by more, and by 3 of its deviations.
  double straight_sagitta_px = 0.7;
};

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const ChainSplittingOptions& options);

// Pieces in chain order; neighbouring pieces share their end point, points that no piece of
// min_points covers are left out. `closed` matters to the curvature alone: the ends of a closed
// chain always end pieces.
// Errors: INVALID_ARGUMENT for options or coordinates that are not finite.
absl::StatusOr<std::vector<ChainPiece>> SplitChain(std::span<const Eigen::Vector2f> points,
                                                   bool closed,
                                                   const ChainSplittingOptions& options);

// Whether points that follow each other bend: see straight_sagitta_px. Fewer than 5 do not.
bool IsCurved(std::span<const Eigen::Vector2f> points, double straight_sagitta_px);

}  // namespace horopter
