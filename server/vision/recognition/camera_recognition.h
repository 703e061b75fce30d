// Recognition under cameras that are known before any part is.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

struct AspectWork;  // interpretation/aspect_route.h

// Of a request, empty: attempts that are given it search no image twice. They are given the same
// objects, hints and ground.
std::shared_ptr<AspectWork> MakeAspectWork();

// By aspects, without matching and without linking views: what one image shows is transferred into
// all others. cameras: one entry per image. Nothing where fewer than two are known and where the
// images leave any doubt, of the parts or of the cameras: then the other ways are to be asked. log,
// work: may be null. Errors: INVALID_ARGUMENT (sizes do not agree, options), CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeWithCameras(const RecognitionInput& input,
                                                       const KnownCameras& cameras,
                                                       const RecognitionOptions& options,
                                                       const StopRequested& stop,
                                                       const StepListener& on_step,
                                                       RefusalLog* log,
                                                       AspectWork* work);

}  // namespace horopter
