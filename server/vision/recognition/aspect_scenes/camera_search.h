// The parts of a scene whose cameras are known before (a station's, a robot's, a reconstruction's
// from texture): what one image shows is transferred into all others, adjusted under the cameras as
// a prior, and asked of all views. Nothing is linked.
#pragma once

#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

// input.search is given; input.generators and input.priors are not read. cameras: one entry per
// image, two and more known. The scene's frame is theirs, in metres. A scene without objects and
// views where no part is borne out by two views; a view that shows none of what it should is left
// out. Once `stop` asks, what was found so far; the first part that a searched image shows is
// completed whatever the hurry. Nothing once `cancelled` asks.
LinkedScene FindInCameras(const AspectLinkInput& input,
                          const KnownCameras& cameras,
                          const AspectLinkOptions& options = {},
                          const StopRequested& stop = {},
                          const StopRequested& cancelled = {});

// The same as a proposal to SearchScene, which looks for what else there is: what the first image
// that shows a part leads to.
AspectScene StartInCameras(const AspectLinkInput& input,
                           const KnownCameras& cameras,
                           const AspectLinkOptions& options = {},
                           const StopRequested& stop = {});

}  // namespace horopter
