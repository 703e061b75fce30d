// Scenes under one focal length, as the views of one camera have it.
#pragma once

#include <optional>

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

// Focal lengths that differ more than those of one camera, or of a cell's, are mostly not seen: the
// scene under the one of them that explains most and leaves the edges where they are. Nothing where
// they differ little, are known, or no one of them will do.
std::optional<AspectScene> WithOneCamera(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const SceneObjects& objects,
                                         const LinkedScene& scene,
                                         const StopRequested& stop);

}  // namespace horopter
