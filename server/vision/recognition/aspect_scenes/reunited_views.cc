#include "server/vision/recognition/aspect_scenes/reunited_views.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <optional>

#include "server/base/stop_scope.h"
#include "server/vision/recognition/aspect_scenes/hypothesis_support.h"
#include "server/vision/recognition/aspect_scenes/link_turns.h"

namespace horopter {
namespace {

constexpr double kSameTurnRad = 0.15;  // between motions that are one; chosen

using Views = std::vector<bool>;

// Views that bear an object out.
Views ViewsOf(const LinkedObject& o) {
  Views out(o.shown.size());
  for (std::size_t v = 0; v < out.size(); ++v)
    out[v] = o.shown[v] && o.views[v].score >= kLeastChance;
  return out;
}

bool Meet(const Views& a, const Views& b) {
  for (std::size_t v = 0; v < a.size(); ++v) {
    if (a[v] && b[v]) return true;
  }
  return false;
}

bool AreAmong(const Views& a, const Views& b) {
  for (std::size_t v = 0; v < a.size(); ++v) {
    if (a[v] && !b[v]) return false;
  }
  return true;
}

struct Reunion {
  AspectScene scene;
  Views turned;
  Rigid3 motion;     // of what the turned views show
  int agreeing = 0;  // other objects that agree, less those that contradict
};

bool AreOneMotion(const Reunion& a, const Reunion& b) {
  return a.turned == b.turned &&
         Eigen::AngleAxisd(a.motion.R.transpose() * b.motion.R).angle() < kSameTurnRad;
}

// Keeps the best, one of each motion.
void Offer(Reunion reunion, std::size_t most, std::vector<Reunion>* found) {
  const auto same = std::find_if(found->begin(), found->end(), [&](const Reunion& other) {
    return AreOneMotion(reunion, other);
  });
  if (same == found->end()) {
    found->push_back(std::move(reunion));
  } else if (reunion.agreeing > same->agreeing) {
    *same = std::move(reunion);
  }
  std::stable_sort(found->begin(), found->end(), [](const Reunion& a, const Reunion& b) {
    return a.agreeing > b.agreeing;
  });
  if (found->size() > most) found->resize(most);
}

class Reuniting {
 public:
  Reuniting(const LinkedScene& scene, std::span<const AspectModel> models)
      : scene_(scene), models_(models) {
    for (const LinkedObject& o : scene.objects) views_.push_back(ViewsOf(o));
  }

  // Turns the views of the second object.
  Reunion Of(std::size_t first, std::size_t second, const Rigid3& rotation) const {
    const Views& turned = views_[second];
    const Rigid3 motion = scene_.objects[first].scene_from_object * rotation.Inverse() *
                          scene_.objects[second].scene_from_object.Inverse();
    Reunion out;
    out.turned = turned;
    out.motion = motion;
    out.scene.views = scene_.views;
    for (std::size_t v = 0; v < turned.size(); ++v) {
      std::optional<AspectSceneView>& view = out.scene.views[v];
      if (turned[v] && view) view->camera_from_scene = view->camera_from_scene * motion.Inverse();
    }
    for (std::size_t i = 0; i < scene_.objects.size(); ++i) {
      if (!AreAmong(views_[i], turned)) out.scene.objects.push_back(PlacedAt(i, {}));
    }
    const std::size_t kept = out.scene.objects.size();
    for (std::size_t i = 0; i < scene_.objects.size(); ++i) {
      if (!Meet(views_[i], turned)) continue;
      const AspectSceneObject moved = PlacedAt(i, motion);
      const bool known = std::any_of(out.scene.objects.begin(),
                                     out.scene.objects.begin() + static_cast<std::ptrdiff_t>(kept),
                                     [&](const auto& o) { return IsInPlaceOf(o, moved); });
      const bool alone = AreAmong(views_[i], turned);
      if (i != second) out.agreeing += known ? 1 : alone ? 0 : -1;
      if (!known && alone) out.scene.objects.push_back(moved);
    }
    return out;
  }

  bool MayBeOne(std::size_t a, std::size_t b) const {
    return scene_.objects[a].object == scene_.objects[b].object && !Meet(views_[a], views_[b]);
  }

 private:
  AspectSceneObject PlacedAt(std::size_t i, const Rigid3& motion) const {
    return {scene_.objects[i].object, motion * scene_.objects[i].scene_from_object};
  }

  bool IsInPlaceOf(const AspectSceneObject& a, const AspectSceneObject& b) const {
    if (a.object != b.object) return false;
    const RenderMesh& mesh = models_[a.object].object->mesh;
    const Eigen::Vector3d center = mesh.center.cast<double>();
    return (a.scene_from_object * center - b.scene_from_object * center).norm() <
           kOnePlaceShare * mesh.diameter_m;
  }

  const LinkedScene& scene_;
  const std::span<const AspectModel> models_;
  std::vector<Views> views_;  // of each object
};

}  // namespace

std::vector<AspectScene> ReunitedScenes(const LinkedScene& scene,
                                        std::span<const AspectModel> models,
                                        std::size_t most) {
  const Reuniting reuniting(scene, models);
  std::optional<LinkTurns> rotations;  // takes time, and mostly nothing stands twice
  std::vector<Reunion> found;
  for (std::size_t a = 0; a < scene.objects.size(); ++a) {
    for (std::size_t b = a + 1; b < scene.objects.size(); ++b) {
      if (!reuniting.MayBeOne(a, b)) continue;
      LeaveIfStopped();
      if (!rotations) rotations.emplace(models);
      for (const Rigid3& rotation : rotations->Of(scene.objects[a].object)) {
        Reunion reunion = reuniting.Of(a, b, rotation);
        if (reunion.agreeing > 0) Offer(std::move(reunion), most, &found);
      }
    }
  }
  std::vector<AspectScene> out;
  for (Reunion& reunion : found) out.push_back(std::move(reunion.scene));
  return out;
}

}  // namespace horopter
