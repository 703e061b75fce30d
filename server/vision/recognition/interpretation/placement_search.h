// Where each object may be in a scene whose cameras are known.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/interpretation/scene_expansion.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scene/support_surface.h"

namespace horopter {

// One round of growth.
struct PlacementRound {
  bool thorough = true;  // also hypotheses that were refined and not verified; on all threads
  bool first = false;    // the cameras know one part only
  bool search_plane = true;
};

// Placements of all objects suggested by the hypotheses of the registered views, by `earlier`
// placements in cameras that differ little, and, where the scene has a plane, by the edges seen on
// the given surfaces; refined and verified over all registered views (no occlusion considered),
// best score first. search: the evidence that parts are looked for in, `context` itself or what
// remains of it (remaining_evidence.h); they are judged by all of it. Of a catalog of more than
// ShortlistOptions::searched objects only the most promising are looked for, see shortlist.h.
// shortlist: the objects that are ranked (one flag each); empty: all, and it receives those that
// the next call in the same scene needs to look at.
std::vector<PlacedObject> CollectPlacements(const JointContext& context,
                                            const JointContext& search,
                                            const HypothesisTable& hypotheses,
                                            const SceneModel& scene,
                                            const std::vector<SearchSurface>& surfaces,
                                            std::span<const PlacedObject> earlier,
                                            const PlacementRound& round,
                                            std::vector<bool>* shortlist);

}  // namespace horopter
