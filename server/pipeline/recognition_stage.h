// The stage of recognition, with what must come before it where aspects alone do not answer.
#pragma once

#include "server/base/stop_token.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

// Recognition by the aspects alone, else after matching and reconstruction, which `input` then
// holds: the metric stage uses the matches too. The step in which time ran short, and what was not
// begun for it, is told in the answer.
// cameras: what is known of them before (given_cameras.h), one per image, which is tried first;
// else no views. log: may be null. Errors: those of the stages.
absl::Status RunRecognition(PipelineOptions options,
                            const SceneRequest& request,
                            const KnownCameras& cameras,
                            const StopRequested& stop,
                            RefusalLog* log,
                            RecognitionInput* input,
                            PipelineResult* result);

// What a request says about the cameras, for the reconstruction; empty: nothing.
std::vector<ViewPrior> PriorsOf(const SceneRequest& request);

}  // namespace horopter
