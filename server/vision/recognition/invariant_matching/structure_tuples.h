// Which points of a component are asked for together: conditioning and visibility choose, not
// neighbourhood.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "server/vision/invariants/six_point_sets.h"
#include "server/vision/invariants/six_points.h"
#include "server/vision/recognition/invariant_matching/key_index.h"
#include "server/vision/recognition/invariant_matching/scene_structure.h"

namespace horopter {

struct SixTupleOptions {
  int max_sets = 20000;   // best spread sets of a component that are looked at
  int max_tuples = 3000;  // kept of a component, fewest expected hits first
  double gate = 7.81;     // chi-square of three degrees of freedom, 95 %
  SixPointOptions invariants;
  SixPointSetOptions sets;
};

struct SixTuple {
  std::array<int, 6> points{};  // of the structure
  SixPointInvariants invariants;
  // Share of the catalog's keys expected inside the gates of all labelings, were their density
  // flat after the catalog's transformation.
  double expected_share = 0.0;
};

// Of one component's points; empty with fewer than six or when all sets of six are degenerate.
std::vector<SixTuple> ChooseSixTuples(const SceneStructure& structure,
                                      std::span<const int> component,
                                      const FeatureTransform& transform,
                                      const SixTupleOptions& options);

}  // namespace horopter
