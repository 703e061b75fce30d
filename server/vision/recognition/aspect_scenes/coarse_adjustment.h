// Drafts of scenes adjusted to the images at a coarse scale.
#pragma once

#include "server/vision/recognition/aspect_scenes/scene_objects.h"

namespace horopter {

// Adjusts a draft of a scene; returns the rms of the edges met, pixels.
double AdjustCoarsely(const AspectLinkInput& input,
                      const AspectLinkOptions& options,
                      AspectScene* scene);

// A scene of one part adjusted from the middle one of its focal lengths: a single image hardly says
// its own, and what is printed on the part is in its place only under the right one.
AspectScene FromOneFocal(const AspectLinkInput& input,
                         const AspectLinkOptions& options,
                         const AspectScene& scene);

}  // namespace horopter
