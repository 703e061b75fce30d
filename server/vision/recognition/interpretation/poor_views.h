// Views of an answer that show little of what the others show: their cameras are wrong, or they are
// images of something else.
#pragma once

#include "server/vision/recognition/interpretation/aspect_route.h"

namespace horopter {

// Leaves out the views of an answer in which the edges that cameras should see of its objects are
// found much less than in the middle one, of three and more. Returns how many.
int LeaveOutPoorViews(const AspectJudgement& judgement, RecognitionResult* answer);

}  // namespace horopter
