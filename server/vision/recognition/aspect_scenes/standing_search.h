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

struct StandingSearchOptions {
  double step_share = 0.14;     // of the diameter: between the places tried first
  double yaw_step_rad = 0.2;    // between the turns tried first
  double reach_share = 0.16;    // of the size: how far an edge may lie at first ...
  double fine_share = 0.04;     // ... and at last
  int max_faces = 6;            // a part is tried on, the safest first
  int max_places = 12000;       // of a part; larger planes are cut around the parts
  double min_first = 0.50;      // support of what views show at first; half of it may be hidden
  int judged_per_object = 300;  // places and turns that are looked at with all points
  int climbed_per_object = 60;  // ... and improved at first
  int kept_per_object = 4;
  double min_size_px = 25.0;  // of a part's diameter in the image
  int threads = 1;
};

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
    const StandingSearchOptions& options = {},
    const StopRequested& stop = {});

}  // namespace horopter
