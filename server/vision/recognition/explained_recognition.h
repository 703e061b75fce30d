// Recognition that keeps what it refuses of one object.
#pragma once

#include "absl/status/statusor.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"

namespace horopter {

struct AspectWork;  // interpretation/aspect_route.h

// As the functions of recognition.h, with the same answers; log, work: may be null.
absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop,
                                                   const StepListener& on_step,
                                                   RefusalLog* log,
                                                   AspectWork* work);

}  // namespace horopter
