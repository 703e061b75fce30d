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
