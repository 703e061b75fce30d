// The metric scene of what was recognised, with the ground that it stands on; called by pipeline.cc
// and what it calls.
#pragma once

#include "absl/status/status.h"
#include "server/base/stop_token.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

// Fills result->trace.metric and, of a station, result->station. Nothing to do without objects.
// Errors: those of RefineMetricScene.
absl::Status RunEuclidean(const PipelineOptions& options,
                          const SceneRequest& request,
                          const RecognitionInput& input,
                          const StopRequested& stop,
                          PipelineResult* result);

}  // namespace horopter
