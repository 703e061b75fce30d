#include "server/vision/recognition/print_learning.h"

#include <deque>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/interpretation/surface_print.h"

namespace horopter {
namespace {

// What the objects but one hide of an image.
DepthBuffer DepthOfOthers(const AnsweredImages& scene,
                          const AspectImage& image,
                          const CalibratedCamera& view,
                          const AnsweredImages::Placed* one) {
  PinholeCamera camera = WorkingCamera(image, view.camera);
  camera.k1 = 0.0;
  DepthBuffer out = MakeDepthBuffer(image.width, image.height);
  for (const AnsweredImages::Placed& o : scene.objects) {
    if (&o != one)
      RenderDepth(o.model->mesh, camera, view.camera_from_scene * o.scene_from_object, &out);
  }
  return out;
}

}  // namespace

absl::StatusOr<SurfacePrint> LearnPrintFrom(const ObjectModel& model,
                                            const std::vector<AnsweredImages>& scenes,
                                            int threads,
                                            const StopRequested& stop) {
  // Sights point to these.
  std::deque<std::vector<AspectImage>> images;
  std::deque<DepthBuffer> hidden;
  std::vector<PrintSights> instances;
  for (const AnsweredImages& scene : scenes) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped while a print was learnt");
    images.push_back(MakeAspectImagesOnGround(scene.images, {}, {}, threads));
    for (const AnsweredImages::Placed& o : scene.objects) {
      if (o.model->id != model.id) continue;
      PrintSights& sights = instances.emplace_back();
      for (std::size_t v = 0; v < scene.views.size(); ++v) {
        const AspectImage& image = images.back()[v];
        if (!scene.views[v] || image.width == 0) continue;
        hidden.push_back(DepthOfOthers(scene, image, *scene.views[v], &o));
        sights.push_back({&image,
                          scene.views[v]->camera,
                          scene.views[v]->camera_from_scene * o.scene_from_object,
                          &hidden.back()});
      }
    }
  }
  return LearnPrint(model, instances);
}

}  // namespace horopter
