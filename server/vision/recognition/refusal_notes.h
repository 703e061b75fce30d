// What leaves a scene on its way to an answer.
#pragma once

#include <algorithm>
#include <vector>

#include "server/vision/recognition/refusals.h"
#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// Notes placements of the logged object that leave the scene; without a log nothing.
class RefusalNotes {
 public:
  explicit RefusalNotes(RefusalLog* log) : log_(log) {}

  void Begin(const SceneModel& scene) {
    before_.clear();
    for (const PlacedObject& p : scene.objects) {
      if (log_ != nullptr && p.object == log_->object) before_.push_back(p);
    }
  }
  // What left since Begin. value_of: what the test measured of a placement.
  template <typename ValueOf>
  void Left(const SceneModel& scene, AcceptanceTest test, double needed, const ValueOf& value_of) {
    for (const PlacedObject& p : before_) {
      if (std::none_of(scene.objects.begin(), scene.objects.end(), [&](const PlacedObject& o) {
            return o.object == p.object;
          })) {
        log_->refusals.push_back({test, p.scene_from_object, scene.views, value_of(p), needed});
      }
    }
    Begin(scene);
  }

 private:
  RefusalLog* log_;
  std::vector<PlacedObject> before_;
};

}  // namespace horopter
