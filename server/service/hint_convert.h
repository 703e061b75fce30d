// What a request says of its cameras and its gripper, checked.
#pragma once

#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "server/pipeline/scene.h"
#include "server/vision/geometry/lens_model.h"

namespace horopter::v1 {
class CameraHint;
class RecognizeSceneRequest;
}  // namespace horopter::v1

namespace horopter {

// Highest standard deviations that are taken of a pose: of a rotation, of a coordinate.
inline constexpr double kMaxRotationSigmaRad = 1.0;
inline constexpr double kMaxPositionSigmaM = 10.0;

// All return INVALID_ARGUMENT naming the field; `field` is that of the hint.

// The image that a hint is about.
struct HintedImage {
  int width = 0, height = 0;
  bool cropped = false;
};

// Of the image as it is, or rectified when it has a lens (LensFromProto). What is no camera of such
// an image (intrinsics_check.h) is refused.
absl::StatusOr<CameraHint> HintFromProto(const v1::CameraHint& proto,
                                         const HintedImage& image,
                                         const std::string& field);

// Empty: a pinhole camera with square pixels and at most k1, which needs no rectification.
absl::StatusOr<std::optional<LensModel>> LensFromProto(const v1::CameraHint& proto,
                                                       const HintedImage& image,
                                                       const std::string& field);

// Whether a valid hint has such a lens.
bool HasLens(const v1::CameraHint& proto);

// Empty: the pose is not known.
absl::StatusOr<std::optional<CameraPoseHint>> PoseHintFromProto(const v1::CameraHint& proto,
                                                                const std::string& field);

// Empty: the request names no gripper.
absl::StatusOr<std::optional<GripperTools>> GripperFromProto(
    const v1::RecognizeSceneRequest& proto);

}  // namespace horopter
