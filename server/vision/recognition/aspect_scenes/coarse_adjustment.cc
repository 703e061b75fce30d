#include "server/vision/recognition/aspect_scenes/coarse_adjustment.h"

#include <vector>

#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr double kOneCameraSigma = 0.02;  // of ln f
constexpr int kCoarsePoints = 120;        // of an object and view; chosen, for time

Eigen::Vector3d CenterOf(const AspectLinkInput& input, int object, const Rigid3& pose) {
  return pose * input.models[object].object->mesh.center.cast<double>();
}

}  // namespace

double AdjustCoarsely(const AspectLinkInput& input,
                      const AspectLinkOptions& options,
                      AspectScene* scene) {
  AspectAdjustmentOptions coarse = options.adjustment;
  coarse.render_px = options.quick_render_px;
  coarse.search_px = {8.0, 5.0, 3.0};
  coarse.max_points = kCoarsePoints;
  std::vector<const RenderMesh*> meshes;
  for (const AspectModel& model : input.models) meshes.push_back(&model.object->mesh);
  return AdjustToEdges(input.images, meshes, coarse, options.threads, scene);
}

AspectScene FromOneFocal(const AspectLinkInput& input,
                         const AspectLinkOptions& options,
                         const AspectScene& scene) {
  std::vector<double> focals;
  for (const auto& view : scene.views) {
    if (view) focals.push_back(RelativeFocal(view->camera));
  }
  const AspectSceneObject& part = scene.objects.front();
  AspectScene out = WithOneFocal(scene,
                                 CenterOf(input, part.object, part.scene_from_object),
                                 Median(&focals),
                                 kOneCameraSigma);
  AdjustCoarsely(input, options, &out);
  for (std::size_t v = 0; v < out.views.size(); ++v) {
    if (!out.views[v]) continue;
    out.views[v]->prior_log_focal = scene.views[v]->prior_log_focal;
    out.views[v]->log_focal_sigma = scene.views[v]->log_focal_sigma;
  }
  return out;
}

}  // namespace horopter
