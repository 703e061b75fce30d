#include "server/vision/recognition/aspect_scenes/scene_similarity.h"

#include <algorithm>

#include "server/vision/recognition/aspect_search/find_aspects.h"

namespace horopter {
namespace {

constexpr double kAlikeShare = 0.06;  // of the size: poses nearer are the same; chosen

bool AreAlikeAsTheyAre(const AspectScene& scene,
                       const AspectSceneObject& object,
                       const AspectScene& other,
                       const Rigid3& there,
                       const ObjectAspects& aspects) {
  AspectModel plain;  // without symmetries
  plain.object = &aspects;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    if (!other.views[v]) return false;
    const PinholeCamera& camera = scene.views[v]->camera;
    const Rigid3 pose = scene.views[v]->camera_from_scene * object.scene_from_object;
    const double size = SizePx(plain, camera, pose);
    if (PoseDistancePx(plain,
                       camera,
                       pose,
                       other.views[v]->camera,
                       other.views[v]->camera_from_scene * there) > kAlikeShare * size)
      return false;
  }
  return true;
}

bool AreAlike(const AspectScene& scene,
              const AspectSceneObject& object,
              const AspectScene& other,
              const AspectSceneObject& there,
              const AspectModel& model) {
  const auto alike = [&](const Rigid3& pose) {
    return AreAlikeAsTheyAre(scene, object, other, pose, *model.object);
  };
  return alike(there.scene_from_object) ||
         std::any_of(model.symmetries.begin(), model.symmetries.end(), [&](const Rigid3& s) {
           return alike(there.scene_from_object * s);
         });
}

}  // namespace

bool IsWithin(const AspectScene& scene,
              const AspectScene& other,
              std::span<const AspectModel> models) {
  return std::all_of(scene.objects.begin(), scene.objects.end(), [&](const auto& o) {
    return std::any_of(other.objects.begin(), other.objects.end(), [&](const auto& there) {
      return there.object == o.object && AreAlike(scene, o, other, there, models[o.object]);
    });
  });
}

}  // namespace horopter
