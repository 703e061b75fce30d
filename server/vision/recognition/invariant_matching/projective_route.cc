#include "server/vision/recognition/invariant_matching/projective_route.h"

#include <Eigen/Dense>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/invariant_matching/route_votes.h"

namespace horopter {
namespace {

constexpr double kAxisToleranceRad = 0.05;  // of AssociationForm::kAxes

using SixMatches = std::array<VertexMatch, 6>;

// The order of the tuple's points in which the first four have the largest determinant.
std::array<int, 6> BestBasisFirst(const SceneStructure& structure, const SixTuple& tuple) {
  std::array<int, 6> best{0, 1, 2, 3, 4, 5};
  double largest = -1.0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i + 1; j < 6; ++j) {
      std::array<int, 6> order{0, 0, 0, 0, i, j};
      Eigen::Matrix4d basis;
      for (int k = 0, n = 0; k < 6; ++k) {
        if (k == i || k == j) continue;
        basis.col(n) = structure.points[tuple.points[k]].homogeneous();
        order[n++] = k;
      }
      const double determinant = std::abs(basis.determinant());
      if (determinant > largest) largest = determinant, best = order;
    }
  }
  return best;
}

// Point k of the labeling's order with vertex k of the stored key.
SixMatches ByCyclicOrder(const SixTuple& tuple,
                         const SixPointLabeling& labeling,
                         const SixVertexKey& key) {
  SixMatches out;
  for (int k = 0; k < 6; ++k) {
    out[labeling.groups[k][0]] = {key.vertices[k], tuple.points[labeling.groups[k][0]]};
  }
  return out;
}

absl::StatusOr<SixMatches> ByAxes(const SceneStructure& structure,
                                  const SixTuple& tuple,
                                  const ObjectModel& model,
                                  const SixVertexKey& key,
                                  double tolerance) {
  std::array<Eigen::Vector4d, 6> points, vertices;
  for (int k = 0; k < 6; ++k) {
    points[k] = structure.points[tuple.points[k]].homogeneous();
    vertices[k] = (model.vertices[key.vertices[k]] / model.diameter_m).homogeneous();
  }
  HOROPTER_ASSIGN_OR_RETURN(const auto vertex_of, AssociateByAxes(points, vertices, tolerance));
  SixMatches out;
  for (int k = 0; k < 6; ++k) out[k] = {key.vertices[vertex_of[k]], tuple.points[k]};
  return out;
}

// One tuple of the structure, by the number `index` of its component.
struct TupleQuestion {
  const SceneStructure& structure;
  const SixTuple& tuple;
  int index = -1;
  std::array<int, 6> basis;  // best conditioned points first
};

// Adds the vertices that have the tuple's invariants, under every labelling of it.
absl::Status AskIndex(const TupleQuestion& question,
                      const KeyIndexSnapshot& index,
                      const ObjectTable& table,
                      const ProjectiveRouteOptions& options,
                      std::vector<TupleHit>* hits) {
  for (const SixPointLabeling& labeling : question.tuple.invariants.labelings) {
    const auto found = index.Find(KeyTable::kSixPoints, labeling.key, options.tuples.gate);
    if (!found.ok()) continue;  // a covariance that is singular: nothing can be asked
    for (const KeyHit& hit : *found) {
      const int object = table.AtSlot(hit.slot);
      if (object < 0) continue;
      const SixVertexKey& key = table.object(object).keys->six_points[hit.key];
      TupleHit& out = hits->emplace_back();
      out.object = object;
      out.tuple = question.index;
      SixMatches matches;
      if (options.association == AssociationForm::kCyclicOrder) {
        matches = ByCyclicOrder(question.tuple, labeling, key);
      } else {
        HOROPTER_ASSIGN_OR_RETURN(matches,
                                  ByAxes(question.structure,
                                         question.tuple,
                                         *table.object(object).model,
                                         key,
                                         kAxisToleranceRad));
      }
      for (int k = 0; k < 6; ++k) out.matches[k] = matches[question.basis[k]];
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<StructureRouteResult> ProjectiveHypotheses(const SceneStructure& structure,
                                                          const KeyIndexSnapshot& index,
                                                          std::span<const StructureObject> objects,
                                                          const ProjectiveRouteOptions& options,
                                                          const StopRequested& stop) {
  HOROPTER_ASSIGN_OR_RETURN(ObjectTable table, ObjectTable::Make(objects));
  StructureRouteResult result;
  result.components = StructureComponents(structure, options.route.components);
  const StructureEvidence evidence = GatherEvidence(structure);
  const FeatureTransform& transform = index.Transform(KeyTable::kSixPoints);
  for (std::size_t c = 0; c < result.components.size(); ++c) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped between components");
    const std::vector<SixTuple> tuples =
        ChooseSixTuples(structure, result.components[c], transform, options.tuples);
    std::vector<TupleHit> hits;
    std::size_t asked = 0;
    for (std::size_t t = 0; t < tuples.size(); ++t) {
      if (static_cast<int>(hits.size()) >= options.route.max_hits) break;
      const std::size_t first = hits.size();
      const std::array<int, 6> basis = BestBasisFirst(structure, tuples[t]);
      const TupleQuestion question{structure, tuples[t], static_cast<int>(t), basis};
      HOROPTER_RETURN_IF_ERROR(AskIndex(question, index, table, options, &hits));
      ++asked;
      if (hits.size() > first + options.route.max_hits_per_tuple) hits.resize(first);
      for (std::size_t i = first; i < hits.size(); ++i) {
        hits[i].hits_of_tuple = static_cast<int>(hits.size() - first);
      }
    }
    result.counts["tuples"] += static_cast<double>(asked);
    HOROPTER_RETURN_IF_ERROR(
        JudgeHits({TransformGroup::kCollineation, evidence, options.route, stop, &table},
                  {result.components[c], static_cast<int>(c)},
                  std::move(hits),
                  &result));
  }
  result.counts["components"] = static_cast<double>(result.components.size());
  SortHypotheses(&result.hypotheses);
  return result;
}

}  // namespace horopter
