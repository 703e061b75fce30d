#include "server/vision/recognition/interpretation/aspect_starts.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr double kKnownLogSigma = 0.1;  // a focal length known better is not searched for

}  // namespace

std::vector<std::optional<AspectSceneView>> SceneViews(
    const std::vector<std::optional<CalibratedCamera>>& views) {
  std::vector<std::optional<AspectSceneView>> out;
  for (const auto& view : views) {
    out.emplace_back();
    if (view) {
      out.back() = AspectSceneView{view->camera,
                                   view->camera_from_scene,
                                   std::log(view->camera.focal_px),
                                   kNominalFocalLogSigma};
    }
  }
  return out;
}

std::vector<AspectViewPrior> ViewPriors(const JointContext& context,
                                        std::span<const AspectImage> images) {
  std::vector<AspectViewPrior> priors;
  for (std::size_t v = 0; v < images.size(); ++v) {
    priors.push_back({context.start_cameras[v], context.focal_log_sigma[v]});
    if (context.focal_log_sigma[v] < context.options.focal_log_sigma) continue;
    priors.back().camera.focal_px = NominalCamera(images[v]).focal_px;
    priors.back().log_focal_sigma = kNominalFocalLogSigma;
  }
  return priors;
}

bool IsKnown(const AspectViewPrior& prior) {
  return prior.log_focal_sigma < kKnownLogSigma;
}

std::optional<AspectScene> Searched(AspectScene scene, const AspectSearch& search) {
  for (AspectSceneObject& o : scene.objects) {
    const auto model = std::find(search.objects.begin(), search.objects.end(), o.object);
    if (model == search.objects.end()) return std::nullopt;
    o.object = static_cast<int>(model - search.objects.begin());
  }
  return scene;
}

}  // namespace horopter
