// From one linked part to the whole scene: more objects, better cameras, one explanation.
#pragma once

#include <vector>

#include "server/vision/recognition/candidates/corner_search.h"
#include "server/vision/recognition/candidates/prospects.h"
#include "server/vision/recognition/candidates/table_search.h"
#include "server/vision/recognition/learnt_constants.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scene/support_surface.h"

namespace horopter {

struct ExpansionOptions {
  bool use_pool = true;         // also the refined but unverified hypotheses
  int kept_per_object = 12;     // distinct placements refined over all views
  float quick_reach_px = 9.0f;  // working pixels, of the transfer into the other views
  float min_quick = 0.40f;      // mean quick score over the views
  double accept_score =
      kChanceSupport;             // of objects on the supporting plane, or when no plane is known
  double off_plane_score = 0.78;  // of objects that rest on nothing we know
  double plane_tolerance_m = 0.006;
  double max_shared_volume = 0.08;
  double max_shared_edges =
      0.5;  // share of an object's explained edges that accepted objects explain already
  // Evidence (log odds, verdict.h) of an upright part that stands on nothing we know, and of parts
  // whose edges are taken out of the search for others.
  double floating_evidence = 4.0;
  double sure_evidence = 4.0;
  // Of half hidden parts (AddHiddenParts). Of 258 wrong placements beside the parts of scenes of
  // parts-dev, parts-train and of other parts none stands so and reaches both, of 6 right ones 5
  // do.
  double hidden_score = 0.50;
  double hidden_sharpness = 0.50;
  double hidden_slack = 0.06;    // of score before its own refinement in the final cameras
  double sure_scene = 0.9;       // probability of a scene to which they are added
  double doubtful_score = 0.42;  // of parts whose tops are searched though they are not accepted
  int max_surfaces = 6;          // heights searched, the plane included
  int plane_voters = 40;         // best placements that vote for the plane
  TableSearchOptions table;
  bool use_table = true;  // parts that stand on the surfaces
  CornerSearchOptions corners;
  ProspectOptions prospects;
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
std::optional<ScenePlane> PlaneFromMatches(const JointContext& context,
                                           const std::vector<std::optional<RecognizedView>>& views);

// Plane on which the best placements that do not share space rest in stable poses, at least two of
// them; empty otherwise (a single part has several stable poses that its image does not tell
// apart).
std::optional<ScenePlane> FindSupportPlane(const JointContext& context,
                                           const std::vector<std::optional<RecognizedView>>& views,
                                           std::span<const PlacedObject> placements,
                                           const ExpansionOptions& options);

}  // namespace horopter
