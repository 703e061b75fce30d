#include "server/vision/recognition/interpretation/poor_views.h"

#include <algorithm>
#include <vector>

#include "server/vision/recognition/aspect_scenes/doubtful_views.h"
#include "server/vision/recognition/interpretation/aspect_starts.h"

namespace horopter {

int LeaveOutPoorViews(const AspectJudgement& judgement, RecognitionResult* answer) {
  LinkedScene scene;
  scene.views = SceneViews(answer->views);
  scene.objects = judgement.objects;
  scene.agreement.surface.views.resize(scene.views.size());
  const std::vector<bool> poor = PoorViews(scene, kPoorShare);
  for (std::size_t v = 0; v < poor.size(); ++v) {
    if (!poor[v]) continue;
    answer->views[v].reset();
    for (SceneObject& o : answer->objects) {
      if (v < o.view_scores.size()) o.view_scores[v] = -1.0;
    }
  }
  return static_cast<int>(std::count(poor.begin(), poor.end(), true));
}

}  // namespace horopter
