// Where a request asks for parts to be looked for, checked.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/pipeline/scene.h"
#include "server/vision/geometry/lens_model.h"

namespace horopter::v1 {
class Camera;
class RecognizeSceneRequest;
class SceneImage;
}  // namespace horopter::v1

namespace horopter {

inline constexpr int kMaxImageRegions = 64;  // of an image
inline constexpr int kMaxSpaceRegions = 16;

// Of an image as it was sent, of width x height pixels; nothing: all of it. lens: where it is
// rectified, what of the rectified image shows the boxes. Errors: INVALID_ARGUMENT naming the
// field below `field`, that of the image.
absl::StatusOr<std::optional<SearchedPart>> RegionsFromProto(const v1::SceneImage& proto,
                                                             int width,
                                                             int height,
                                                             const std::optional<LensModel>& lens,
                                                             const std::string& field);

// Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<std::vector<SpaceBox>> SpaceRegionsFromProto(const v1::RecognizeSceneRequest& proto);

// Places the request's space boxes in its images (PlaceBoxes). Errors: INVALID_ARGUMENT naming
// `regions`: no camera is known, no image shows them.
absl::Status PlaceRegions(SceneRequest* request);

// Whether image i is searched in parts, and in which.
void RegionsToProto(const SceneRequest& request, int i, v1::Camera* camera);

}  // namespace horopter
