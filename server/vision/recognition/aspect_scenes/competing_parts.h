// How well other parts do in the places of a scene's objects.
#pragma once

#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

// Notes the best score that another part's hypothesis of a single image, settled in all views, has
// in the place of each object: LinkedObject::competing_object.
void FindBestCompeting(const AspectLinkInput& input,
                       const AspectLinkOptions& options,
                       const ViewLinks& links,
                       const SceneObjects& objects,
                       LinkedScene* scene);

// Poses of an object that are farther apart than this share of its size in an image are others.
inline constexpr double kOtherPoseShare = 0.1;

// Of the smaller diameter: centres so near are one place; chosen.
inline constexpr double kSamePlaceShare = 0.6;

}  // namespace horopter
