// What the cameras of single views rest on before any part is known.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/reconstruction/calibrated_scene.h"

namespace horopter {

struct ReconstructedPoint;

enum class MatchSource {
  kNone,      // the view has no camera
  kTexture,   // points of what is printed, grained or scratched on surfaces
  kFeatures,  // corners and edges
};

struct ViewMatches {
  MatchSource source = MatchSource::kNone;  // most matches are of
  int matches = 0;  // points seen in the view that other views see too and its camera agrees with
  double rms_px = 0.0;  // their residuals
};

// Counted from the points of a reconstruction over the supporting plane or from tracks. A point
// without a junction is one of the plane's texture; its residual is not known here and counts as
// `rms_px`, that of the whole.
std::vector<ViewMatches> CountViewMatches(std::span<const ReconstructedPoint> points,
                                          std::span<const std::optional<CalibratedView>> views,
                                          std::span<const ImageFeatures> features,
                                          double rms_px);

}  // namespace horopter
