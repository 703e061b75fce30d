#include "tests/diagnose/reduced_images.h"

#include <opencv2/imgcodecs.hpp>

#include "server/pipeline/large_images.h"

namespace horopter {

absl::StatusOr<ReducedScene> ReadReduced(const BopScene& scene) {
  ReducedScene out = {scene, {}};
  SceneRequest request;
  std::vector<double> factors;
  for (const BopImage& image : scene.images) {
    request.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    if (request.images.back().empty()) {
      return absl::InvalidArgumentError(image.path + ": not an image");
    }
    factors.push_back(ReductionOf(request.images.back().size(), kLeastSidePx, kSmallSidePx));
  }
  out.images = ReducedRequest(request, factors).images;
  for (size_t v = 0; v < out.images.size(); ++v) {
    PinholeCamera& camera = out.scene.images[v].camera;
    camera.focal_px /= factors[v];
    camera.cx = (camera.cx + 0.5) / factors[v] - 0.5;
    camera.cy = (camera.cy + 0.5) / factors[v] - 0.5;
    camera.width = out.images[v].cols;
    camera.height = out.images[v].rows;
  }
  return out;
}

}  // namespace horopter
