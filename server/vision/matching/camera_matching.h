// Corners and edges matched between views whose cameras are known (thesis 2.7, 3.3).
#pragma once

#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/projection.h"
#include "server/vision/matching/matching.h"

namespace horopter {

// Projection to pixels of a lens without distortion.
CameraMatrix MatrixOf(const CalibratedCamera& view);

// As MatchViews, along the epipolar lines that the cameras give (their lenses undone) and without a
// search for planes: component is -1 throughout. cameras: one per image, empty: not known; such
// views are in no pair. Errors: INVALID_ARGUMENT for sizes that do not agree, CANCELLED.
absl::StatusOr<MatchingResult> MatchViewsOfCameras(
    std::span<const cv::Mat> images,
    std::span<const ImageFeatures> features,
    std::span<const std::optional<CalibratedCamera>> cameras,
    const MatchingOptions& options,
    const StopRequested& stop = {});

}  // namespace horopter
