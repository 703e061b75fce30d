// Grasp files of Isaac Sim's grasp editor (YAML, format isaac_grasp 1.0).
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// position [m] and orientation {w, xyz} are object_from_gripper; the gripper frame is taken as
// ours: z approach, x closing. confidence is the quality. cspace_position (closed on the part) and
// pregrasp_cspace_position (open) hold finger travel in metres: of one joint, both fingers move
// alike; of more, they add up. The format has no pre-grasp pose: pregrasp_position and
// pregrasp_orientation are ours, and other readers pass over them. Errors: NOT_FOUND,
// INVALID_ARGUMENT naming file and grasp.
absl::StatusOr<std::vector<Grasp>> ReadIsaacGrasps(const std::string& path);

// The inverse. Errors: FAILED_PRECONDITION (cannot be written).
absl::Status WriteIsaacGrasps(const std::string& path,
                              const std::string& object_frame,
                              const std::vector<Grasp>& grasps);

}  // namespace horopter
