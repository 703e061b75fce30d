// Parts that stand on the plane under the parts already found, looked for in all views at once:
// with known cameras and a known plane a part has three degrees of freedom and a few faces to rest
// on, so that every place can be tried. Finds what no single image shows well enough.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

inline constexpr double kStandingStepShare =
    0.14;  // of the diameter: between the places tried first

inline constexpr double kStandingYawStepRad = 0.2;  // between the turns tried first

inline constexpr double kStandingReachShare =
    0.16;  // of the size: how far an edge may lie at first

inline constexpr double kLeastStandingPx = 25.0;  // of a part's diameter in an image

struct StandingCandidate {
  AspectSceneObject placed;
  double support = 0.0;  // mean over the views that show it, above what chance gives
};

// Best first over all parts, the first places of parts before second ones. `views` are those of the
// scene in which `plane` is given; one without camera is not asked. What was found so far when
// stopped.
std::vector<StandingCandidate> FindStanding(
    std::span<const AspectImage> images,
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const AspectModel> models,
    const StandingPlane& plane,
    std::span<const AspectSceneObject> taken,
    int threads = 1,
    const StopRequested& stop = {});

}  // namespace horopter
