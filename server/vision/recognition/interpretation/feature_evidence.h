// Whether the images show the features of a placed part (holes, pockets, bosses) where its CAD has
// them: a part without one of them, or with it somewhere else, fits nearly as well.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/model_features.h"
#include "server/vision/recognition/acceptance.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/interpretation/pose_odds.h"

namespace horopter {

struct FeatureEvidence {
  double log_odds = 0.0;    // that it is there rather than not; 0: no image says anything
  double visible_px = 0.0;  // of its edges that nothing hides, all views, working pixels
};

// One per feature. Edges between faces are found as often as light lets them: as often as those of
// the part that are of no feature. hidden: see LogOddsBetween.
std::vector<FeatureEvidence> RateFeatures(std::span<const AspectImage> images,
                                          const std::vector<std::optional<CalibratedCamera>>& views,
                                          const SeenPart& part,
                                          const std::vector<ModelFeature>& features,
                                          std::span<const DepthBuffer> hidden,
                                          PoseChoiceAcceptance acceptance = {});

}  // namespace horopter
