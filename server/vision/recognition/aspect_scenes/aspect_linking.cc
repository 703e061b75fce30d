#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

#include <algorithm>

#include "server/vision/recognition/aspect_scenes/scene_objects.h"

namespace horopter {
namespace {

constexpr int kCoarsePoints = 120;  // of an object and view; chosen, for time

}  // namespace

StopRequested WithEffort(const AspectLinkInput& input, const StopRequested& stop) {
  return [&input, &stop] {
    return IsStopRequested(stop) || (input.effort != nullptr && input.effort->IsSpent());
  };
}

int LinkedScene::registered() const {
  return static_cast<int>(
      std::count_if(views.begin(), views.end(), [](const auto& v) { return v.has_value(); }));
}

void SortBestFirst(LinkedScene* scene) {
  std::stable_sort(scene->objects.begin(), scene->objects.end(), [](const auto& a, const auto& b) {
    return a.score > b.score;
  });
}

AspectScene SceneOf(const LinkedScene& linked) {
  AspectScene scene;
  scene.views = linked.views;
  for (const LinkedObject& o : linked.objects)
    scene.objects.push_back({o.object, o.scene_from_object});
  return scene;
}

void AdjustCoarsely(const AspectLinkInput& input,
                    const AspectLinkOptions& options,
                    AspectScene* scene) {
  AspectAdjustmentOptions coarse = options.adjustment;
  coarse.render_px = kQuickRenderPx;
  coarse.search_px = {8.0, 5.0, 3.0};
  coarse.max_points = kCoarsePoints;
  std::vector<const RenderMesh*> meshes;
  for (const AspectModel& model : input.models) meshes.push_back(&model.object->mesh);
  AdjustToEdges(input.images, meshes, coarse, options.threads, scene);
}

}  // namespace horopter
