// What the aspects start from that is known before: cameras, and scenes that others propose.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/interpretation/aspect_route.h"

namespace horopter {

// Cameras as the aspects' scenes have them, with the nominal deviation of their focal lengths.
std::vector<std::optional<AspectSceneView>> SceneViews(
    const std::vector<std::optional<CalibratedCamera>>& views);

// What is known of the views' cameras before any part is.
std::vector<AspectViewPrior> ViewPriors(const JointContext& context,
                                        std::span<const AspectImage> images);

// Whether the focal length is known so well that it is not searched for.
bool IsKnown(const AspectViewPrior& prior);

// A scene by the numbers of the catalog by those of the parts that are searched for; nothing when
// one of its objects is not.
std::optional<AspectScene> Searched(AspectScene scene, const AspectSearch& search);

}  // namespace horopter
