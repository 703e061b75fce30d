// The search for the scene that explains the images best: generators propose scenes, cheapest
// first, while the best one leaves a doubt; each proposal is adjusted, completed with what its
// views show, and verified in all of them. Further images are searched as they are needed.
#pragma once

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

// The scene that explains most; without objects when nothing links. One image alone gives the scene
// of its best hypothesis. Stops early with what it has; unless `cancelled` says that it is not
// wanted any more, views that have been searched by then are still linked.
LinkedScene SearchScene(const AspectLinkInput& input,
                        const AspectLinkOptions& options = {},
                        const StopRequested& stop = {},
                        const StopRequested& cancelled = {});

}  // namespace horopter
