// What both bottom-up routes do after their queries. Many tuples say where an object is, each
// badly: votes for transformations, clustered so that evidence adds up, associated and judged
// (thesis 4.4, appendix F).
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/invariant_matching/projective_route.h"

namespace horopter {

// Objects by slot of the index, with shapes made when they are first asked for.
class ObjectTable {
 public:
  // Errors: INVALID_ARGUMENT.
  static absl::StatusOr<ObjectTable> Make(std::span<const StructureObject> objects);

  // Index into the objects; -1 for a slot that is not asked about.
  int AtSlot(int slot) const {
    return slot >= 0 && slot < static_cast<int>(at_slot_.size()) ? at_slot_[slot] : -1;
  }
  const StructureObject& object(int i) const { return objects_[i]; }
  const ObjectShape& shape(int i);

 private:
  std::span<const StructureObject> objects_;
  std::vector<int> at_slot_;
  std::vector<std::optional<ObjectShape>> shapes_;
};

// A key of the catalog that a query found: which vertices the tuple's points would be. Of six, the
// first four should be the best conditioned.
struct TupleHit {
  int object = -1;
  int tuple = -1;
  std::array<VertexMatch, 6> matches;
  int size = 6;
  int hits_of_tuple = 1;
};

// What hits are judged with: the same for all components of a structure.
struct HitJudge {
  TransformGroup group;
  const StructureEvidence& evidence;
  const StructureRouteOptions& options;
  const StopRequested& stop;
  ObjectTable* objects;
};
struct HitComponent {
  std::span<const int> points;
  int index = -1;
};

// Votes of the hits (rarest tuples first, as many as the options allow), clustered by object; the
// best modes associated and judged. Appends to result. Errors: CANCELLED, those of FindModes.
absl::Status JudgeHits(const HitJudge& judge,
                       const HitComponent& component,
                       std::vector<TupleHit> hits,
                       StructureRouteResult* result);

// Best first, without repetitions.
void SortHypotheses(std::vector<StructureHypothesis>* hypotheses);

}  // namespace horopter
