// Scenes that the reconstructed structure proposes: invariants of its points ask the catalog's
// index, and each hypothesis says where one part and the cameras are (thesis 4.2 - 4.6, 5.3; ADR
// 0011). The images judge them like what any other generator proposes.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/aspect_scenes/scene_judgement.h"
#include "server/vision/recognition/initialization/decomposition.h"
#include "server/vision/recognition/invariant_matching/corner_structure.h"
#include "server/vision/recognition/invariant_matching/metric_route.h"
#include "server/vision/recognition/invariant_matching/projective_route.h"
#include "server/vision/recognition/invariant_matching/space_corners.h"
#include "server/vision/recognition/object/joint_context.h"
#include "server/vision/reconstruction/grow_projective.h"
#include "server/vision/reconstruction/matched_tracks.h"
#include "server/vision/reconstruction/reconstruction.h"

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
  SpaceCornerOptions corners;
  CornerStructureOptions structure;
  GrowOptions reconstruction;  // of the projective route
  MetricRouteOptions metric = MetricDefaults();
  ProjectiveRouteOptions projective = ProjectiveDefaults();
  int refined = 24;                                                // scenes proposed, of each way
  DecompositionMethod decomposition = DecompositionMethod::kNone;  // of the projective route
  CommonUpgradeOptions upgrade;  // of kCommon and what starts from it

  static MetricRouteOptions MetricDefaults();
  static ProjectiveRouteOptions ProjectiveDefaults();
};

// Scenes of one part each, in the cameras of the reconstruction, scaled by the part; best first.
// Empty where there are no two cameras, no structure or no hypothesis, or on a stop.
std::vector<AspectScene> MetricScenes(const JointContext& context,
                                      std::span<const ImageFeatures> features,
                                      const Reconstruction& reconstruction,
                                      const RouteCatalog& catalog,
                                      const BottomUpOptions& options);

// Scenes of one part each, cameras P H = K [R | t] of its collineation into a projective
// reconstruction of the matched tracks, which nothing is assumed about before; best first. Empty as
// above.
std::vector<AspectScene> ProjectiveScenes(const JointContext& context,
                                          std::span<const ImageFeatures> features,
                                          const MatchingResult& matching,
                                          const RouteCatalog& catalog,
                                          const BottomUpOptions& options);

// Pairs of point tracks that a segment joins in two views or more: it ends in the junctions of
// both.
std::vector<std::array<int, 2>> TrackEdges(std::span<const FeatureTrack> points,
                                           std::span<const ImageFeatures> features);

}  // namespace horopter
