// The ground of a scene whose parts gave the cameras: their texture, if it has any, tells focal
// lengths better than the parts do.
#pragma once

#include <vector>

#include "server/base/stop_token.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/matching/ground_motion.h"

namespace horopter {

// Where each view has the supporting plane that the scene's parts stand on: homographies from
// coordinates in it (metres, about the first part) to pixels, without the lenses' distortion. Empty
// lists without a plane.
PlaneInViews PlaneOf(const MetricScene& scene);

// The matches of that plane's patches between the views, in which the cameras had no part. None
// where the ground shows no texture, or shows it elsewhere: a background that moves against the
// parts.
MatchingResult FollowGround(const SceneRequest& request,
                            const MetricScene& scene,
                            const PipelineOptions& options,
                            const StopRequested& stop);

// The options of an adjustment with these matches, which say less than those that gave the cameras:
// where the ground is glossy, not flat, or seen through a lens that the homographies leave out,
// they are off together.
PipelineOptions WithFollowedGround(PipelineOptions options);

// Whether the scene adjusted with the plane's matches is as good an answer as the one without: the
// cameras explain the plane, and all of its objects are there, with their edges where they are
// seen.
bool KeepsAnswer(const MetricScene& with_plane, const MetricScene& without);

}  // namespace horopter
