// References of a request, from the wire.
#pragma once

#include "absl/status/status.h"
#include "server/pipeline/scene.h"

namespace horopter::v1 {
class RecognizeSceneRequest;
}

namespace horopter {

// Fills reference and further_references. Errors: INVALID_ARGUMENT naming the field.
absl::Status AddReferences(const v1::RecognizeSceneRequest& proto, SceneRequest* request);

}  // namespace horopter
