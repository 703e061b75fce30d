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

struct ExpansionOptions {
  bool use_pool = true;         // also the refined but unverified hypotheses
  int kept_per_object = 12;     // distinct placements refined over all views
  float quick_reach_px = 9.0f;  // working pixels, of the transfer into the other views
  float min_quick = 0.40f;      // mean quick score over the views
  PlacementAcceptance acceptance;
  // Log-likelihood ratio of parts whose edges are taken out of the search for others.
  double sure_log_odds = 4.0;
  double doubtful_score = 0.42;  // of parts whose tops are searched though they are not accepted
  int max_surfaces = 6;          // heights searched, the plane included
  int plane_voters = 40;         // best placements that vote for the plane
  PlaneSearchOptions plane_search;
  bool use_plane_search = true;  // parts that stand on the surfaces
  CornerSearchOptions corners;
  ShortlistOptions shortlist;
  int threads = 1;
};

// The scene's registered views with their edge maps.
std::vector<KnownView> KnownViews(const JointContext& context, const SceneModel& scene);

// Chooses the placements that together explain the scene: greedily by score and size, solid parts
// exclude each other, accepted parts hide what lies behind them, parts stand on the common plane.
// Replaces scene->objects, scene->plane.
void Consolidate(const JointContext& context,
                 const ExpansionOptions& options,
                 std::vector<PlacedObject> candidates,
                 SceneModel* scene);

// Adds what consolidation had no support enough for: parts half hidden by things unknown. Nothing
// is taken back for them, so only where the scene is sure, and only parts that stand upright on its
// plane or on a part of it, beside all others, with edges that fit sharply. candidates: best first.
void AddHiddenParts(const JointContext& context,
                    const ExpansionOptions& options,
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
    std::span<const PlacedObject> placements,
    const ExpansionOptions& options);

}  // namespace horopter
