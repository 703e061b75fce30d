// What an answer says of what is not in it: an object's hypothesis, edges that belong to no object.
#pragma once

#include "absl/status/status.h"
#include "server/base/stop_token.h"
#include "server/pipeline/scene.h"

namespace horopter {

// log: of the object that is to be explained, if any. Fills explanation and unexplained_edges as
// the request asks for them; nothing is computed that is not asked for. Errors: those of
// ExplainObject.
absl::Status ExplainAnswer(const RecognitionInput& input,
                           const RefusalLog& log,
                           const SceneRequest& request,
                           const SceneTrace& trace,
                           const RecognitionOptions& options,
                           const StopRequested& stop,
                           SceneAnswer* answer);

}  // namespace horopter
