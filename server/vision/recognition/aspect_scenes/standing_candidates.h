// What stands on the planes under a scene's objects, where nothing of the scene is.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"

namespace horopter {

// At most `most` of each plane, best first (standing_search.h).
std::vector<AspectSceneObject> FreeStanding(const AspectLinkInput& input,
                                            const AspectLinkOptions& options,
                                            const SceneObjects& objects,
                                            std::span<const StandingPlane> planes,
                                            const AspectScene& scene,
                                            int most,
                                            const StopRequested& stop);

}  // namespace horopter
