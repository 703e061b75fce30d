#include "server/vision/recognition/initialization/rig_initialization.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "absl/container/inlined_vector.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/candidates/plane_search.h"
#include "server/vision/recognition/initialization/plane_initialization.h"
#include "server/vision/recognition/initialization/view_linking.h"

namespace horopter {
namespace {

struct Candidate {
  int object = -1;
  double units_per_metre = 1.0;
  Rigid3 world_from_object;  // metres
  double quick = 0.0;
};

// Depth of the plane z = 0 on the ray through a pixel; a view's own height where the ray misses it.
double PlaneDepth(const CalibratedCamera& view, const Eigen::Vector2d& pixel) {
  const Rigid3 world_from_camera = view.camera_from_scene.Inverse();
  const Eigen::Vector3d ray = NormalizedPoint(view.camera, pixel).homogeneous();
  const double down = (world_from_camera.R * ray).z(), height = world_from_camera.t.z();
  return down < -1e-3 ? -height / down : std::abs(height);
}

// The depth of a view's hypothesis at which the other views support it best; no object when none
// does.
Candidate BestDepth(const JointContext& context,
                    const Reconstruction& reconstruction,
                    int v,
                    const ViewHypothesis& h,
                    const RigInitializationOptions& options) {
  const CalibratedCamera& own = *reconstruction.views[v];
  const PreparedObject& object = *context.objects[h.object];
  const Rigid3 pose = WithFocal(h.camera_from_object, h.camera.focal_px, own.camera.focal_px);
  const Eigen::Vector3d center = pose * object.center;
  if (center.z() <= object.radius_m) return {};
  const double plane = PlaneDepth(own, Project(own.camera, center));
  Candidate best;
  best.quick = options.min_quick;
  for (int step = 0; step < options.scale_steps; ++step) {
    const double share = (step + 0.5) / options.scale_steps;
    const double depth =
        plane * options.nearest * std::pow(options.farthest / options.nearest, share);
    const double units = depth / center.z();
    Rigid3 own_from_world = own.camera_from_scene;
    own_from_world.t /= units;
    const Rigid3 world_from_object = own_from_world.Inverse() * pose;
    absl::InlinedVector<QuickView, 8> others;
    for (int w = 0; w < static_cast<int>(context.views.size()); ++w) {
      if (w == v || !reconstruction.views[w]) continue;
      Rigid3 other = reconstruction.views[w]->camera_from_scene;
      other.t /= units;
      others.push_back(
          {&context.views[w].maps, &reconstruction.views[w]->camera, other * world_from_object});
    }
    const double quick =
        QuickScoreOverViews(object, others, options.reach_px, static_cast<float>(best.quick));
    if (quick > best.quick) best = {h.object, units, world_from_object, quick};
  }
  return best;
}

}  // namespace

std::vector<SceneModel> RigInitialScenes(const JointContext& context,
                                         const HypothesisTable& hypotheses,
                                         const Reconstruction& reconstruction) {
  const RigInitializationOptions& options = context.options.search.rig;
  const int views = static_cast<int>(context.views.size());
  const int known = static_cast<int>(std::count_if(reconstruction.views.begin(),
                                                   reconstruction.views.end(),
                                                   [](const auto& v) { return v.has_value(); }));
  if (known < 2) return {};
  std::vector<std::vector<Candidate>> found(views);
  ParallelFor(views, context.options.threads, [&](int v) {
    if (!reconstruction.views[v]) return;
    for (const ViewHypotheses& of_object : hypotheses[v]) {
      for (int i = 0; i < std::min<int>(options.hypotheses_per_object,
                                        static_cast<int>(of_object.best.size()));
           ++i) {
        if (IsStopRequested(context.give_up)) return;
        const Candidate best = BestDepth(context, reconstruction, v, of_object.best[i], options);
        if (best.object >= 0) found[v].push_back(best);
      }
    }
  });
  std::vector<Candidate> all;
  for (const auto& list : found) all.insert(all.end(), list.begin(), list.end());
  std::stable_sort(all.begin(), all.end(), [](const Candidate& a, const Candidate& b) {
    return a.quick > b.quick;
  });
  if (static_cast<int>(all.size()) > options.refined) all.resize(options.refined);
  std::vector<SceneModel> scenes(all.size());
  ParallelFor(static_cast<int>(all.size()), context.options.threads, [&](int i) {
    if (IsStopRequested(context.give_up)) return;
    auto scene = RefinedHypothesis(
        context, reconstruction, all[i].units_per_metre, all[i].object, all[i].world_from_object);
    if (scene) scenes[i] = *std::move(scene);
  });
  std::erase_if(scenes, [](const SceneModel& s) { return s.objects.empty(); });
  std::stable_sort(scenes.begin(), scenes.end(), [](const auto& x, const auto& y) {
    return x.description_gain > y.description_gain;
  });
  return scenes;
}

}  // namespace horopter
