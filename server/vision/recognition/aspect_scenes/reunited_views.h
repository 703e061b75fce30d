// Views that a symmetric part joined by a wrong one of its turns.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

// Scenes, likeliest first, in which two objects of one part that no view shows together are one:
// the views that show the second are turned until it is where the first is, with what only they
// show. What both kinds of views show must stand where it stood, or another pair become one as
// well; objects that become one are so once. At most `most`.
std::vector<AspectScene> ReunitedScenes(const LinkedScene& scene,
                                        std::span<const AspectModel> models,
                                        std::size_t most);

}  // namespace horopter
