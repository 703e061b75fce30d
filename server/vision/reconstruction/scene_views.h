// What several ways of reconstruction ask of a calibrated scene's views.
#pragma once

#include <optional>
#include <span>

#include "server/vision/reconstruction/calibrated_scene.h"

namespace horopter {

using OptionalViews = std::span<const std::optional<CalibratedView>>;

int RegisteredViews(OptionalViews views);

// Largest |ln(f_a / f_b)| of the views that both have; 0 where they share none.
double LargestFocalDifference(OptionalViews a, OptionalViews b);

}  // namespace horopter
