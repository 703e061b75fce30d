#include "server/vision/recognition/aspect_scenes/one_camera.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr double kUnlikeFocals = 0.35;  // largest difference of log focal lengths left alone
constexpr double kNewFocal = 1.08;      // ratio of those that are tried for all views
// Of ln f about that one.
constexpr double kOneCameraSigma = 0.02;
// Of the rms of its edges. Photographs of one camera: 0.97 - 1.04; scenes of cad-dev with every
// other image enlarged by 1.5: 1.09 - 2.8. Commit 8c74a24.
constexpr double kOneCameraRms = 1.06;
constexpr int kCoarsePoints = 120;  // of an object and view; chosen, for time

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

std::optional<AspectScene> WithOneCamera(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const SceneObjects& objects,
                                         const LinkedScene& linked,
                                         const StopRequested& stop) {
  std::vector<double> focals;
  for (const auto& view : linked.views) {
    if (!view) continue;
    if (view->log_focal_sigma < kNominalFocalLogSigma) return std::nullopt;  // somebody knows
    focals.push_back(RelativeFocal(view->camera));
  }
  if (focals.size() < 3 || linked.objects.empty()) return std::nullopt;
  std::sort(focals.begin(), focals.end());
  if (std::log(focals.back() / focals.front()) < kUnlikeFocals) return std::nullopt;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const LinkedObject& o : linked.objects)
    middle += CenterOf(input, o.object, o.scene_from_object);
  middle /= static_cast<double>(linked.objects.size());
  AspectScene apart = SceneOf(linked);
  const double apart_px = AdjustCoarsely(input, options, &apart);
  AspectScene most;
  double most_score = -1.0;
  double last = 0.0;
  for (const double focal : focals) {
    if (focal < kNewFocal * last || IsStopRequested(stop)) continue;
    last = focal;
    AspectScene scene = WithOneFocal(SceneOf(linked), middle, focal, kOneCameraSigma);
    if (AdjustCoarsely(input, options, &scene) > kOneCameraRms * apart_px) continue;
    const double score = objects.Sift(&scene);
    if (score <= most_score) continue;
    most_score = score;
    most = std::move(scene);
  }
  if (most.objects.empty()) return std::nullopt;
  return most;
}

}  // namespace horopter
