#include "server/vision/recognition/route_votes.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kStopStride = 256;  // votes between two looks at the stop token

// Restricts quick support to the component: a part of the structure is one object's.
SceneStructure PointsOf(const SceneStructure& structure, std::span<const int> points) {
  SceneStructure out;
  for (const int i : points) out.points.push_back(structure.points[i]);
  return out;
}

int VerticesOfTuple(TransformGroup group) {
  return group == TransformGroup::kCollineation ? 6 : 4;
}

bool SameMatches(const StructureHypothesis& a, const StructureHypothesis& b) {
  if (a.object != b.object || a.vertices.size() != b.vertices.size()) return false;
  return std::is_permutation(a.vertices.begin(), a.vertices.end(), b.vertices.begin());
}

}  // namespace

absl::StatusOr<ObjectTable> ObjectTable::Make(std::span<const StructureObject> objects) {
  ObjectTable table;
  table.objects_ = objects;
  table.shapes_.resize(objects.size());
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const StructureObject& o = objects[i];
    if (o.model == nullptr || o.keys == nullptr || o.slot < 0) {
      return absl::InvalidArgumentError(absl::StrCat("objects: ", i, " lacks model, keys or slot"));
    }
    if (o.slot >= static_cast<int>(table.at_slot_.size())) table.at_slot_.resize(o.slot + 1, -1);
    if (table.at_slot_[o.slot] >= 0) {
      return absl::InvalidArgumentError(absl::StrCat("objects: slot ", o.slot, " twice"));
    }
    table.at_slot_[o.slot] = static_cast<int>(i);
  }
  return table;
}

const ObjectShape& ObjectTable::shape(int i) {
  if (!shapes_[i]) shapes_[i] = ShapeOf(*objects_[i].model);
  return *shapes_[i];
}

void SortHypotheses(std::vector<StructureHypothesis>* hypotheses) {
  std::stable_sort(hypotheses->begin(), hypotheses->end(), [](const auto& a, const auto& b) {
    return a.log_odds > b.log_odds;
  });
  std::vector<StructureHypothesis> kept;
  for (StructureHypothesis& h : *hypotheses) {
    const bool known = std::any_of(
        kept.begin(), kept.end(), [&](const auto& other) { return SameMatches(h, other); });
    if (!known) kept.push_back(std::move(h));
  }
  *hypotheses = std::move(kept);
}

absl::Status JudgeHits(TransformGroup group,
                       const StructureEvidence& evidence,
                       std::span<const int> component_points,
                       int component,
                       std::vector<TupleHit> hits,
                       const StructureRouteOptions& options,
                       const StopRequested& stop,
                       ObjectTable* objects,
                       StructureRouteResult* result) {
  const SceneStructure& structure = *evidence.structure;
  const SceneStructure near = PointsOf(structure, component_points);
  std::stable_sort(hits.begin(), hits.end(), [](const TupleHit& a, const TupleHit& b) {
    return a.hits_of_tuple < b.hits_of_tuple;
  });
  result->counts["hits"] += static_cast<double>(hits.size());
  if (static_cast<int>(hits.size()) > options.max_hits) hits.resize(options.max_hits);
  std::vector<VertexVote> votes;
  std::vector<std::vector<int>> of_object;
  for (std::size_t i = 0; i < hits.size(); ++i) {
    if (i % kStopStride == 0 && IsStopRequested(stop)) return absl::CancelledError("stopped");
    const TupleHit& hit = hits[i];
    const ObjectShape& shape = objects->shape(hit.object);
    const auto H = FitTransform(group, structure, shape, hit.matches, {});
    if (!H.ok()) continue;
    const double extent = MappedExtent(shape, *H);
    if (!std::isfinite(extent)) continue;
    const int support = QuickVertexSupport(near, shape, *H, options.quick_reach * extent);
    if (support < VerticesOfTuple(group) + options.min_extra_support) continue;
    if (hit.object >= static_cast<int>(of_object.size())) of_object.resize(hit.object + 1);
    of_object[hit.object].push_back(static_cast<int>(votes.size()));
    votes.push_back(
        {hit.object, hit.tuple, hit.matches, *H, 1.0 / hit.hits_of_tuple, support});
  }
  std::vector<VoteMode> modes;
  for (const std::vector<int>& list : of_object) {
    if (list.empty()) continue;
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<VoteMode> of_one,
                              ClusterVotes(votes, list, options.votes));
    modes.insert(modes.end(), of_one.begin(), of_one.end());
  }
  std::stable_sort(modes.begin(), modes.end(), [](const VoteMode& a, const VoteMode& b) {
    return a.support != b.support ? a.support > b.support : a.weight > b.weight;
  });
  result->counts["votes"] += static_cast<double>(votes.size());
  result->counts["modes"] += static_cast<double>(modes.size());
  if (static_cast<int>(modes.size()) > options.judged_modes) modes.resize(options.judged_modes);
  result->counts["judged"] += static_cast<double>(modes.size());
  std::vector<StructureHypothesis> found;
  for (const VoteMode& mode : modes) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    const ObjectShape& shape = objects->shape(mode.object);
    const auto judge = [&](const Eigen::Matrix4d& H) {
      StructureHypothesis h = JudgeTransform(group, evidence, shape, H, options.support);
      h.object = mode.object;
      h.component = component;
      h.votes = mode.tuples;
      return h;
    };
    StructureHypothesis best = judge(mode.structure_from_shape);
    const std::vector<VertexMatch> associated = AssociateMode(
        votes, mode, static_cast<int>(structure.points.size()), shape.size(), options.votes);
    ConsistencyOptions consistency;
    consistency.reach = options.quick_reach * MappedExtent(shape, mode.structure_from_shape);
    const auto agreed = FindConsistentMatches(group, structure, shape, associated, consistency);
    if (agreed.ok()) {
      StructureHypothesis other = judge(agreed->structure_from_shape);
      if (other.log_odds > best.log_odds) best = std::move(other);
    }
    if (std::isfinite(best.log_odds)) found.push_back(std::move(best));
  }
  SortHypotheses(&found);
  if (static_cast<int>(found.size()) > options.kept) found.resize(options.kept);
  for (StructureHypothesis& h : found) result->hypotheses.push_back(std::move(h));
  return absl::OkStatus();
}

}  // namespace horopter
