// Cameras from texture, before corners and edges are matched or any part is known.
#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// Matching and reconstruction by texture points, reported as steps of these stages: one solution,
// or the two that texture cannot tell apart (counted as `texture_solutions`). Untrusted, with the
// reason, where the images have no texture or it does not tell. Errors: CANCELLED.
absl::StatusOr<std::vector<Reconstruction>> ReconstructTexture(const SceneRequest& request,
                                                               const PipelineOptions& options,
                                                               const StopRequested& stop,
                                                               std::vector<StageReport>* stages);

// Whether more images show the parts of the one result than those of the other: under which of two
// solutions they stand where they were photographed.
bool IsShownByMore(const RecognitionResult& one, const RecognitionResult& other);

// Corners and edges matched along the epipolar lines of a reconstruction's cameras. Errors:
// CANCELLED.
absl::StatusOr<MatchingResult> MatchUnderCameras(const SceneRequest& request,
                                                 std::span<const ImageFeatures> features,
                                                 const Reconstruction& reconstruction,
                                                 const PipelineOptions& options,
                                                 const StopRequested& stop,
                                                 std::vector<StageReport>* stages);

}  // namespace horopter
