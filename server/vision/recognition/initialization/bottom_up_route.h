// The routes through the reconstructed structure: invariants of its points ask the catalog's index,
// and the hypotheses become scenes that the images judge like those of any other route (ADR 0011).
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/initialization/decomposition.h"
#include "server/vision/recognition/invariant_matching/corner_structure.h"
#include "server/vision/recognition/invariant_matching/metric_route.h"
#include "server/vision/recognition/invariant_matching/projective_route.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/reconstruction/grow_projective.h"
#include "server/vision/reconstruction/matched_tracks.h"

namespace horopter {

// The objects of a request in an index of keys; must not outlive the objects.
struct RouteCatalog {
  std::vector<StructureObject> objects;  // in the order of the request
  KeyIndexSnapshot index;
};

// Takes the given index and slots; without them an index over the objects is built, which takes
// time in proportion to their keys. Errors: INVALID_ARGUMENT (slots are not one per object).
absl::StatusOr<RouteCatalog> MakeRouteCatalog(
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    const KeyIndexSnapshot* index,
    std::span<const int> slots);

// How several objects' collineations become one metric frame (thesis 5.3; decomposition.h).
enum class DecompositionMethod {
  kNone,       // one object each starts a scene: its own collineation tells the cameras
  kPerObject,  // the first object gives the upgrade, every other one its polar factor
  kCommon,     // one upgrade from all objects, and their poses, in turn
  kMetric,     // ... then together, on the distances in the metric frame
  kImages,     // ... on the distances in the images
};

struct BottomUpOptions {
  CornerStructureOptions structure;
  GrowOptions reconstruction;  // of the projective route
  MetricRouteOptions metric = MetricDefaults();
  ProjectiveRouteOptions projective = ProjectiveDefaults();
  double corner_share = 0.005;  // corners nearer than this, of the distance to the cameras, are one
  double min_log_odds = 0.0;    // of a hypothesis that is compared with the images
  float quick_reach_px = 10.0f;  // working pixels
  double min_quick = 0.35;       // mean over the views
  int refined = 24;              // scenes refined and judged, of each route
  int max_scales = 3;            // of the metric route's scenes
  DecompositionMethod decomposition = DecompositionMethod::kNone;  // of the projective route
  CommonUpgradeOptions upgrade;  // of kCommon and what starts from it
  double max_stretch = 1.5;      // of an object under the upgrade, above which it is something else

  static MetricRouteOptions MetricDefaults();
  static ProjectiveRouteOptions ProjectiveDefaults();
};

// Scenes of one part each, in the cameras of the reconstruction, scaled by the part; one for each
// of the best scales, see BestScales. Empty where there are no two cameras, no structure or no
// hypothesis, or on a stop.
std::vector<SceneModel> MetricInitialScenes(const JointContext& context,
                                            const Reconstruction& reconstruction,
                                            const RouteCatalog& catalog,
                                            const BottomUpOptions& options);

// Scenes of one part each, cameras P H = K [R | t] of its collineation into a projective
// reconstruction of the matched tracks, which nothing is assumed about before; largest
// description-length gain first. Empty as above.
std::vector<SceneModel> ProjectiveInitialScenes(const JointContext& context,
                                                std::span<const ImageFeatures> features,
                                                const RouteCatalog& catalog,
                                                const BottomUpOptions& options);

// Pairs of point tracks that a segment joins in two views or more: it ends in the junctions of
// both.
std::vector<std::array<int, 2>> TrackEdges(std::span<const FeatureTrack> points,
                                           std::span<const ImageFeatures> features);

}  // namespace horopter
