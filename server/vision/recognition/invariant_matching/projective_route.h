// Recognition of a structure known up to a collineation: no assumption about the cameras
// (thesis 4.2 - 4.4).
#pragma once

#include <map>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/recognition/invariant_matching/association.h"
#include "server/vision/recognition/invariant_matching/key_index.h"
#include "server/vision/recognition/invariant_matching/object_collineation.h"
#include "server/vision/recognition/invariant_matching/structure_support.h"
#include "server/vision/recognition/invariant_matching/structure_tuples.h"

namespace horopter {

// An object that may be found: its model and its keys, as the index has them in slot `slot`.
struct StructureObject {
  const ObjectModel* model = nullptr;
  const ObjectKeys* keys = nullptr;
  int slot = -1;
};

struct StructureRouteOptions {
  ComponentOptions components;
  SupportOptions support;
  // Best conditioned tuples are asked for first, until a component has this many hits. More find
  // more, in linear time.
  int max_hits = 300000;
  int max_hits_per_tuple = 3000;   // a tuple with more says too little
  ConsistencyOptions consistency;  // of a mode's table; its reach is kQuickReach
  int judged_modes = 80;           // of a component
  int kept = 10;                   // hypotheses of a component
};

struct ProjectiveRouteOptions {
  StructureRouteOptions route;
  SixTupleOptions tuples;
  AssociationForm association = AssociationForm::kCyclicOrder;
};

struct StructureRouteResult {
  std::vector<std::vector<int>> components;     // points of the structure
  std::vector<StructureHypothesis> hypotheses;  // of all components, best first
  std::map<std::string, double> counts;         // components, tuples, hits, votes, modes, judged
};

// Hypotheses of the same object that put its vertices on the same points are given once. Errors:
// INVALID_ARGUMENT (options, an object without model or keys, slots twice), CANCELLED.
absl::StatusOr<StructureRouteResult> ProjectiveHypotheses(const SceneStructure& structure,
                                                          const KeyIndexSnapshot& index,
                                                          std::span<const StructureObject> objects,
                                                          const ProjectiveRouteOptions& options,
                                                          const StopRequested& stop = {});

}  // namespace horopter
