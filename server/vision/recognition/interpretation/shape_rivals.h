// What else than the answered part may stand in its place: its mirror image, and the parts of the
// catalog that look like it.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

struct ShapeRival {
  int object = -1;        // index into the prepared objects: of the answer's own its mirror image
  bool mirrored = false;  // whether it is a mirror image that is not enrolled
  Rigid3 scene_from_object;
  double log_odds = 0.0;         // of the answer against it, by the edges that only one of them has
  double differing_share = 0.0;  // of the visible edges of both in the images
};

// Of the answer's object number `place`, likeliest first: each adjusted to the images in the
// answer's cameras. Empty for an object without aspects.
std::vector<ShapeRival> RateShapes(const JointContext& context,
                                   std::span<const AspectImage> images,
                                   const RecognitionResult& result,
                                   int place);

// Parts of the catalog that the images show rather than the answered ones take their places; what
// is rather a mirror image of the answered part, or one of it that is clearly stretched, is left
// out; what stays open goes into probabilities, alternatives and `detail`.
void WeighShapes(const JointContext& context,
                 std::span<const AspectImage> images,
                 RecognitionResult* result);

}  // namespace horopter
