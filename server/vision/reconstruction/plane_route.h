// Cameras and points of the views that share a supporting plane: calibration from
// the plane's homographies, then junctions off the plane.
#pragma once

#include <span>

#include "absl/status/statusor.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// The largest plane component of the matching; other views stay empty. Sizes of the arguments agree
// (ReconstructViews checks them). Errors: CANCELLED.
absl::StatusOr<Reconstruction> ReconstructFromPlane(const MatchingResult& matching,
                                                    std::span<const ImageFeatures> features,
                                                    std::span<const ImageSize> sizes,
                                                    std::span<const ViewPrior> priors,
                                                    const ReconstructionOptions& options,
                                                    const StopRequested& stop);

}  // namespace horopter
