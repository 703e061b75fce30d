// Cameras and points without a supporting plane: projective from the tracks of junctions and
// segments, then metric as far as the images allow (thesis 3).
#pragma once

#include <span>

#include "absl/status/statusor.h"
#include "server/vision/reconstruction/matched_tracks.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// Trusted when self-calibration calls the result metric. Where only the focal lengths stay open,
// but not far, the best cameras are given untrusted; where they stay open or no plausible cameras
// fit, none. World: the middle of the points is the origin, z towards the cameras, their mean
// distance 1. Errors: CANCELLED.
absl::StatusOr<Reconstruction> ReconstructFromTracks(const MatchingResult& matching,
                                                     std::span<const ImageFeatures> features,
                                                     std::span<const ImageSize> sizes,
                                                     std::span<const ViewPrior> priors,
                                                     const ReconstructionOptions& options,
                                                     const StopRequested& stop);

}  // namespace horopter
