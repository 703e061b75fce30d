#include "server/pipeline/contradicted_hint.h"

#include "absl/strings/str_format.h"

namespace horopter {

ContradictedHint TellHint(int image, double focal_px, const Eigen::Vector2d& principal_point) {
  return {image,
          focal_px,
          principal_point,
          absl::StrFormat("what is said of the camera of image %d does not fit the image: by the "
                          "image alone its focal length is %.0f pixels and its principal point "
                          "%.0f, %.0f",
                          image,
                          focal_px,
                          principal_point.x(),
                          principal_point.y())};
}

}  // namespace horopter
