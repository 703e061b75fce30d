// What recognition looks for of a part, view by view, for people to see.
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

enum class TemplateEdge : std::uint8_t { kSilhouette, kOcclusion, kCrease };

struct TemplatePoint {
  Eigen::Vector2f image_px = Eigen::Vector2f::Zero();
  float direction_rad = 0.0f;  // of the edge in the image, from u towards v, 0..pi
  TemplateEdge kind = TemplateEdge::kSilhouette;
};

struct TemplateView {
  Rigid3 camera_from_object;
  std::vector<TemplatePoint> points;
};

struct TemplateViews {
  PinholeCamera camera;  // of all of them
  int count = 0;         // of the part's templates
  std::vector<TemplateView> views;
};

// At most `limit` of the part's templates, from number `first` on, in an order in which each run of
// them is spread over the sphere. `data` and `keys`: as the preparer (CatalogPreparer) encoded
// them. Errors: FAILED_PRECONDITION (the data are of another version or geometry, or there are no
// templates in them), DATA_LOSS, INVALID_ARGUMENT.
absl::StatusOr<TemplateViews> ReadTemplates(
    ObjectModel model, std::string_view data, std::string_view keys, int first, int limit);

}  // namespace horopter
