// Objects that are the answered one in another size. Images have no scale: where one part alone is
// recognised and no camera's place is known, a larger one farther away looks the same.
#pragma once

#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

// Lists the same shape in other sizes among the only object's alternatives; the answer is then
// ambiguous. Answers of several objects tell sizes by each other and stay as they are.
void SayScaleAlternatives(const JointContext& context, RecognitionResult* result);

}  // namespace horopter
