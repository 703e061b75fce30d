// When a scene of some of the views needs no further search.
#pragma once

#include <span>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"

namespace horopter {

inline constexpr double kSettledSurface = 0.4;  // ViewAgreement::surface of a settled scene
inline constexpr double kCredibleScore = 0.45;  // of the scene's best object

// Two views and more are linked by an object that is worth looking for others beside.
bool IsCredible(const LinkedScene& scene);

// Of a scene with all views: another object that scores well agrees on them, or the only one scores
// very well and is not round, about whose axis views may turn; and the views do not show different
// surfaces of the best.
bool PartsSettle(const LinkedScene& scene, std::span<const AspectModel> models);

// Three views and more agree on the texture of the ground under the best object: their cameras are
// right, about whatever axis a round one may turn. `agreement` is SceneObjects::WithGround's.
bool GroundSettles(const LinkedScene& scene, const ViewAgreement& agreement);

// All views are there, and one or the other settles them.
bool IsSettled(const LinkedScene& scene,
               std::span<const AspectModel> models,
               const SceneObjects& objects);

}  // namespace horopter
