#include "server/vision/recognition/aspect_scenes/settled_scenes.h"

namespace horopter {
namespace {

// Of the best object: others are looked for in its views, or are known well enough. Of the scenes
// of cad-dev that have parts the right ones have 0.56 and more in two views, those without known
// parts 0.46. Commit 474778a.
constexpr double kSettledScore = 0.5;
// ... where no other agrees, as the views may show several poses of one: a wrong link of a battery
// holder had 0.57 in four views, the right one of it and two more parts 0.58. Commit 38de6ec.
constexpr double kSettledAlone = 0.65;
// ViewAgreement::ground; of wrong scenes none has more than 0.27 (AspectAcceptance::ground_agrees).
constexpr double kSettledGround = 0.35;
constexpr int kGroundViews = 3;

// Before the ground is looked at, which takes time.
bool GroundMaySettle(const LinkedScene& scene) {
  return scene.registered() >= kGroundViews && !scene.objects.empty() &&
         scene.objects.front().score >= kSettledScore;
}

}  // namespace

bool IsCredible(const LinkedScene& scene) {
  return scene.registered() > 1 && !scene.objects.empty() &&
         scene.objects.front().score >= kCredibleScore;
}

bool PartsSettle(const LinkedScene& scene, std::span<const AspectModel> models) {
  if (scene.objects.empty() || scene.agreement.Contradicts(kSettledSurface)) return false;
  const LinkedObject& first = scene.objects.front();
  if (scene.objects.size() > 1 && scene.objects[1].score >= kSettledScore)
    return first.score >= kSettledScore;
  return models[first.object].round.empty() && first.score >= kSettledAlone;
}

bool GroundSettles(const LinkedScene& scene, const ViewAgreement& agreement) {
  return GroundMaySettle(scene) && agreement.ground >= kSettledGround;
}

bool IsSettled(const LinkedScene& scene,
               std::span<const AspectModel> models,
               const SceneObjects& objects) {
  return scene.registered() == static_cast<int>(scene.views.size()) &&
         (PartsSettle(scene, models) ||
          (GroundMaySettle(scene) && GroundSettles(scene, objects.WithGround(scene))));
}

}  // namespace horopter
