// Cameras from texture points alone, before corners and edges are matched or any part is known.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/matching/texture_matching.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// Incremental reconstruction of the texture's tracks; one lens for all images where they are of one
// size, their hints do not differ and a lens each explains them no better. Trusted only where the
// cameras explain nearly all that the pairs agreed on and no other focal lengths do so as well;
// views that share too little with the others stay empty, with the reason. "Not enough" is a result
// with `refusal`, not an error. Points come without junctions: their observations say -1. Errors:
// INVALID_ARGUMENT for sizes that do not agree and priors that are none, CANCELLED.
absl::StatusOr<Reconstruction> ReconstructFromTexture(const TextureMatching& texture,
                                                      std::span<const ImageSize> sizes,
                                                      std::span<const ViewPrior> priors,
                                                      const TextureRouteOptions& options,
                                                      const StopRequested& stop = {});

// The same where images cannot tell two solutions apart (other focal lengths, or relief turned
// inside out, that explain the texture as well): both, each trusted by itself, the likelier first,
// for parts to decide. Else one, trusted or with its refusal.
absl::StatusOr<std::vector<Reconstruction>> SolutionsOfTexture(const TextureMatching& texture,
                                                               std::span<const ImageSize> sizes,
                                                               std::span<const ViewPrior> priors,
                                                               const TextureRouteOptions& options,
                                                               const StopRequested& stop = {});

}  // namespace horopter
