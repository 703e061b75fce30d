// Adds views to a reconstruction one by one, without moving what is there.
#pragma once

#include <span>

#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// Tries every view that is not registered: points and lines that the registered ones triangulate,
// as matches say it sees them (MatchedPairs::kAll), by robust resection. Views with most such
// sights first; one that is registered helps the next. A view that stays out has its
// reason in view_refusals. In a
// trusted reconstruction only a camera whose focal length is known as well as the others' must be
// is added. Returns how many were.
int RegisterRemainingViews(const MatchingResult& matching,
                           std::span<const ImageFeatures> features,
                           std::span<const ImageSize> sizes,
                           std::span<const ViewPrior> priors,
                           const ReconstructionOptions& options,
                           const StopRequested& stop,
                           Reconstruction* reconstruction);

}  // namespace horopter
