// The parts of a scene whose cameras and their places are known, in metres (a calibrated station):
// what one image shows is put where it must be and asked of all others. Nothing is linked, and the
// cameras stay where they are, but for one that was moved.
#pragma once

#include <optional>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

// input.search is given; input.known is not read. rig: one per image, all known. A camera that does
// not show what two others and more do was moved a little: it is found again by the best part. A
// scene without objects and views where the images leave a doubt: parts that score little may be
// chance, and a camera may be somewhere else. Stops early without an answer.
LinkedScene FindInRig(const AspectLinkInput& input,
                      const std::vector<std::optional<AspectSceneView>>& rig,
                      const AspectLinkOptions& options = {},
                      const StopRequested& stop = {});

}  // namespace horopter
