// Recognition under cameras that are known with their places, metres: a calibrated station.
#pragma once

#include <span>

#include "absl/status/statusor.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"

namespace horopter {

// By aspects, without matching and without linking views; the cameras are believed and stay. rig:
// one per image. Nothing where the images leave any doubt, of the parts or of the cameras: then the
// other ways are to be asked. log: may be null. Errors: INVALID_ARGUMENT (sizes do not agree,
// options), CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeInRig(const RecognitionInput& input,
                                                 std::span<const CalibratedCamera> rig,
                                                 const RecognitionOptions& options,
                                                 const StopRequested& stop,
                                                 const StepListener& on_step,
                                                 RefusalLog* log);

}  // namespace horopter
