// Views that a symmetric part joined by a wrong one of its turns.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

// Scenes, likeliest first, in which two objects of one part that no view shows together are one:
// the views that show the second are turned until it is where the first is, by the identity or one
// of the part's symmetric rotations, with what they alone show. Only where more of the other
// objects agree than contradict: those that both kinds of views show, if they come to stand where
// they stood, and those that become one with another of their part; by their centres. At most
// `most`, no two of which turn the same views by nearly the same motion.
std::vector<AspectScene> ReunitedScenes(const LinkedScene& scene,
                                        std::span<const AspectModel> models,
                                        std::size_t most);

}  // namespace horopter
