// From the metric scene to the answer: frames, covariances, grasps and findings in terms of the
// request (thesis 5.4).
#pragma once

#include <memory>
#include <span>

#include "absl/status/status.h"
#include "server/pipeline/scene.h"

namespace horopter {

// Fills cameras, objects, base frame, grasps, findings and scales; `objects` are the prepared
// objects that recognition worked on. The base frame is that of the reference object,
// without one of the cameras in the base; references that contradict it are a finding and give no
// base frame. Adds the reasons: the reference is missing or contradicted, sizes contradict each
// other.
absl::Status FillAnswer(const MetricScene& metric,
                        std::span<const std::shared_ptr<const PreparedObject>> objects,
                        const SceneRequest& request,
                        const GraspOptions& grasps,
                        SceneAnswer* answer);

}  // namespace horopter
