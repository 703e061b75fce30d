// What the aspects start from that is known before: cameras, and another route's scene.
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

// A view's hypotheses under its camera, where that is known.
std::vector<AspectHypothesis> Under(const AspectViewPrior& prior,
                                    std::vector<AspectHypothesis> hypotheses);

// Another route's answer by the numbers of the parts that are searched for; nothing when one of its
// objects is not.
std::optional<AspectScene> KnownScene(const RecognitionResult& answer, const AspectSearch& search);

}  // namespace horopter
