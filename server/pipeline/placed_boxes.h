// Boxes in the robot's base frame as parts of the images (SceneRequest::space_boxes).
#pragma once

#include "absl/status/status.h"
#include "server/pipeline/scene.h"

namespace horopter {

// Adds to SceneRequest::searched what the boxes fill of the images whose cameras are known: focal
// length and place, from the request or its station. An image that shows none of them and has no
// boxes of its own is not searched; one whose camera is not known is searched as it was. Nothing
// changes without boxes. Errors: FAILED_PRECONDITION (no image's camera is known),
// INVALID_ARGUMENT (no image that is known shows any of them).
absl::Status PlaceBoxes(SceneRequest* request);

}  // namespace horopter
