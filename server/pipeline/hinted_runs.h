// Recognition with what is known of the cameras, and again without what the images contradict;
// called by pipeline.cc.
#pragma once

#include "absl/status/status.h"
#include "server/base/stop_token.h"
#include "server/pipeline/hint_check.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

// A request with all that is said of its lenses, and with less; outlives what RunWithHints fills.
struct CameraKnowledge {
  const SceneRequest& request;
  SceneRequest without_files;   // presumed focal lengths
  SceneRequest without_claims;  // what the caller says
  SceneRequest without_both;
};
CameraKnowledge KnowledgeOf(const SceneRequest& request);

// Recognition and adjustment with the hints, and with what is known of a station; again without
// presumed focal lengths, and without the caller's claims, where that finds nothing or the images
// contradict them. test: of the claims, against the answer. Afterwards input->hints are those that
// the answer rests on.
absl::Status RunWithHints(const PipelineOptions& options,
                          const CameraKnowledge& known,
                          const StopRequested& stop,
                          RefusalLog* log,
                          RecognitionInput* input,
                          PipelineResult* result,
                          HintTest* test);

}  // namespace horopter
