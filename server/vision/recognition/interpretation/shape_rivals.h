// What else than the answered part may stand in its place: its mirror image, and the parts of the
// catalog that look like it.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

// Parts of the catalog that the images show rather than the answered ones take their places; what
// is rather a mirror image of the answered part, or one of it that is clearly stretched, is left
// out; what stays open goes into probabilities, alternatives and `detail`.
void WeighShapes(const JointContext& context,
                 std::span<const AspectImage> images,
                 RecognitionResult* result);

}  // namespace horopter
