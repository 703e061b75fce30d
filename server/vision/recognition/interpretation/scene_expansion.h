// From one linked part to the whole scene: more objects, better cameras, one explanation.
#pragma once

#include <vector>

#include "server/vision/recognition/candidates/corner_search.h"
#include "server/vision/recognition/candidates/plane_search.h"
#include "server/vision/recognition/candidates/shortlist.h"
#include "server/vision/recognition/options.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scene/support_surface.h"

namespace horopter {

// The scene's registered views with their edge maps.
std::vector<KnownView> KnownViews(const JointContext& context, const SceneModel& scene);

// Chooses the placements that together explain the scene: greedily by score and size, solid parts
// exclude each other, accepted parts hide what lies behind them, parts stand on the common plane.
// Replaces scene->objects, scene->plane.
void Consolidate(const JointContext& context,
                 std::vector<PlacedObject> candidates,
                 SceneModel* scene);

// Adds what consolidation had no support enough for: parts half hidden by things unknown. Nothing
// is taken back for them, so only where the scene is sure, and only parts that stand upright on its
// plane or on a part of it, beside all others, with edges that fit sharply. candidates: best first.
void AddHiddenObjects(const JointContext& context,
                      std::span<const PlacedObject> candidates,
                      SceneModel* scene);

// The supporting plane from the matched points of its texture; empty with fewer than 20 that agree.
std::optional<SupportingPlane> PlaneFromMatches(
    const JointContext& context, const std::vector<std::optional<CalibratedCamera>>& views);

// Plane on which the best placements that do not share space rest in stable poses, at least two of
// them; empty otherwise (a single part has several stable poses that its image does not tell
// apart).
std::optional<SupportingPlane> PlaneOfPlacements(
    const JointContext& context,
    const std::vector<std::optional<CalibratedCamera>>& views,
    std::span<const PlacedObject> placements);

}  // namespace horopter
