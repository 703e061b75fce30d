// The stage of recognition, with what must come before it where aspects alone do not answer.
#pragma once

#include <span>

#include "server/base/stop_token.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"

namespace horopter {

// Recognition by the aspects alone, else after matching and reconstruction, which `input` then
// holds: the metric stage uses the matches too. The step in which time ran short, and what was not
// begun for it, is told in the answer.
// rig: the cameras of the images where they are known with their places, which are tried first;
// else empty. log: may be null. Errors: those of the stages.
absl::Status RunRecognition(PipelineOptions options,
                            const SceneRequest& request,
                            std::span<const CalibratedCamera> rig,
                            const StopRequested& stop,
                            RefusalLog* log,
                            RecognitionInput* input,
                            PipelineResult* result);

// What a request says about the cameras, for the reconstruction; empty: nothing.
std::vector<ViewPrior> PriorsOf(const SceneRequest& request);

}  // namespace horopter
