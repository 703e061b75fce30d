// An answer drawn over the images of its request.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/overlay/drawing.h"
#include "server/pipeline/scene.h"

namespace horopter::v1 {
class OverlayOptions;
class RecognizeSceneResponse;
}  // namespace horopter::v1

namespace horopter {

// The model of an object by its id; null: it is drawn by its frame's origin alone.
using ModelLookup = std::function<const ObjectModel*(const std::string& id)>;

// One drawing per image: wireframes with names and scores, the best grasp of each object, the
// supporting plane's grid, unexplained edges and the explained object where the answer has them.
std::vector<Drawing> DrawAnswer(const SceneAnswer& answer,
                                const SceneRequest& request,
                                const ModelLookup& models);

// Bytes per pixel that AddOverlays takes beside the images.
int64_t OverlayBytesPerPixel(const v1::OverlayOptions& options);

// The drawings as files. Errors: RESOURCE_EXHAUSTED (out of memory).
absl::Status AddOverlays(const v1::OverlayOptions& options,
                         const SceneRequest& request,
                         const std::vector<Drawing>& drawings,
                         v1::RecognizeSceneResponse* response);

}  // namespace horopter
