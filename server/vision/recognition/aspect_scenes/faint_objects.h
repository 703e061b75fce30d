// Parts whose edges say little, as others hide them or the ground has more of its own: what lies on
// a plane with surer parts, and whose surface is as bright in all views, is there all the same.
#pragma once

#include <vector>

#include "server/vision/recognition/aspect_scenes/scene_objects.h"

namespace horopter {

// Three views are linked and an object is credible: its cameras may be asked for more.
bool MayShowFaintObjects(const LinkedScene& scene);

// Adds those of the candidates, placed in the scene's cameras, that lie on a plane under or on its
// objects and on whose surface the views agree, and sets LinkedObject::surface of all; poses stay
// as they are. Nothing where the scene may not show any (MayShowFaintObjects).
void AddFaintObjects(const AspectLinkInput& input,
                     const AspectLinkOptions& options,
                     const SceneObjects& objects,
                     std::vector<AspectSceneObject> candidates,
                     LinkedScene* scene);

}  // namespace horopter
