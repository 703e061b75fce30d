// What the routes over a reconstruction, a plane or linked single views answer between them.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/interpretation/routes.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"

namespace horopter {

// The reconstruction's cameras are metric and known well enough to be taken as they are.
bool CamerasTrusted(const RecognitionInput& input);

// Asks the given routes by their cost, while time is left and nothing is found that chance does
// not explain, and answers of the best scene what holds: symmetric views aligned, alternatives
// heard, what chance explains left out. Errors: CANCELLED.
absl::StatusOr<RecognitionResult> AnswerByRoutes(const RecognitionInput& input,
                                                 const RecognitionRoutes& routes,
                                                 const JointContext& context,
                                                 RouteWork* work,
                                                 RefusalLog* log);

}  // namespace horopter
