// Recognition of a structure known up to a similarity, or up to a rigid motion once one object has
// told the scale.
#pragma once

#include <optional>
#include <span>

#include "server/vision/invariants/similarity_keys.h"
#include "server/vision/recognition/invariant_matching/projective_route.h"

namespace horopter {

struct MetricRouteOptions {
  StructureRouteOptions route;
  SimilarityKeyOptions keys;
  double gate = 11.07;  // chi-square of five degrees of freedom, 95 %
  // Structure units per metre, when known: keys are then compared in size too.
  std::optional<double> units_per_metre;
  // Support from which the best object tells the scale; objects are then looked for again, in that
  // scale.
  double scale_log_odds = 40.0;
};

struct MetricRouteResult {
  StructureRouteResult found;
  std::optional<double> units_per_metre;  // given, or told by the best object
};

// Errors: INVALID_ARGUMENT (objects, a structure that is not metric), CANCELLED.
absl::StatusOr<MetricRouteResult> MetricHypotheses(const SceneStructure& structure,
                                                   const KeyIndexSnapshot& index,
                                                   std::span<const StructureObject> objects,
                                                   const MetricRouteOptions& options,
                                                   const StopRequested& stop = {});

// Structure units per metre of a similarity from an object.
double UnitsPerMetre(const Eigen::Matrix4d& structure_from_object);

}  // namespace horopter
