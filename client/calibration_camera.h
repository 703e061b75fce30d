// One camera of a calibration file.
#pragma once

#include "absl/status/statusor.h"
#include "client/calibration_document.h"
#include "client/camera_file.h"

namespace horopter {

// Errors: INVALID_ARGUMENT naming the field: no K, no numbers, a lens that is not taken.
absl::StatusOr<CameraFile> CameraOf(const CameraNode& camera);

}  // namespace horopter
