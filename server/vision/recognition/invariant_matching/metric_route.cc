#include "server/vision/recognition/invariant_matching/metric_route.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/base/status_macros.h"
#include "server/vision/recognition/invariant_matching/route_votes.h"

namespace horopter {
namespace {

// Added to the keys' variances: what first order and the models leave out
constexpr double kVarianceFloor = 1e-6;
constexpr double kScaleTolerance = 0.03;  // of log size, beyond what the covariance says
constexpr double kScaleSigmas = 3.0;      // of the log size, beside the tolerance

struct FourTuple {
  KeyTable table = KeyTable::kChains;
  FourVertices points{};
};

// Chains and stars of the component's edges. Both orders of a chain and all of a star's are asked
// for: the catalog has one.
std::vector<FourTuple> TuplesOf(const SceneStructure& structure, std::span<const int> component) {
  std::vector<std::vector<int>> next(structure.points.size());
  const auto inside = [&](int i) {
    return std::binary_search(component.begin(), component.end(), i);
  };
  for (const auto& [a, b] : structure.edges) {
    if (!inside(a) || !inside(b)) continue;
    if (std::find(next[a].begin(), next[a].end(), b) != next[a].end()) continue;
    next[a].push_back(b);
    next[b].push_back(a);
  }
  std::vector<FourTuple> out;
  for (const int b : component) {
    for (const int c : next[b]) {
      for (const int a : next[b]) {
        for (const int d : next[c]) {
          if (a == c || d == b || a == d) continue;
          out.push_back({KeyTable::kChains, {a, b, c, d}});  // its reverse comes from (c, b)
        }
      }
      for (const int d : next[b]) {
        for (const int e : next[b]) {
          if (c == d || c == e || d == e) continue;
          out.push_back({KeyTable::kStars, {b, c, d, e}});
        }
      }
    }
  }
  return out;
}

// Deviation of the mean log distance: the key's five values span the other directions, so the
// covariance of the points is recomputed.
double LogSizeDeviation(const std::array<Eigen::Vector3d, 4>& points,
                        const Eigen::MatrixXd& covariance) {
  Eigen::RowVectorXd gradient = Eigen::RowVectorXd::Zero(12);
  for (int i = 0; i < 4; ++i) {
    for (int k = 0; k < i; ++k) {
      const Eigen::Vector3d d = points[i] - points[k];
      const Eigen::RowVector3d g = d.transpose() / (6.0 * d.squaredNorm());
      gradient.segment<3>(3 * i) += g;
      gradient.segment<3>(3 * k) -= g;
    }
  }
  return std::sqrt(std::max(0.0, (gradient * covariance * gradient.transpose())(0, 0)));
}

absl::Status AskFor(const FourTuple& tuple,
                    int number,
                    const SceneStructure& structure,
                    const KeyIndexSnapshot& index,
                    const MetricRouteOptions& options,
                    const std::optional<double>& units_per_metre,
                    const ObjectTable& table,
                    std::vector<TupleHit>* hits) {
  std::array<Eigen::Vector3d, 4> points;
  for (int k = 0; k < 4; ++k) points[k] = structure.points[tuple.points[k]];
  const Eigen::MatrixXd covariance = structure.CovarianceOf(tuple.points);
  auto key = SimilarityKeyOf(points, covariance, options.keys);
  if (!key) return absl::OkStatus();
  key->key.covariance.diagonal().array() += kVarianceFloor;
  const auto found = index.Find(tuple.table, key->key, options.gate);
  if (!found.ok()) return absl::OkStatus();  // a covariance that is singular: nothing can be asked
  const double size_gate = kScaleTolerance + kScaleSigmas * LogSizeDeviation(points, covariance);
  const std::size_t first = hits->size();
  for (const KeyHit& hit : *found) {
    const int object = table.AtSlot(hit.slot);
    if (object < 0) continue;
    const ObjectKeys& keys = *table.object(object).keys;
    const FourVertexKey& stored =
        tuple.table == KeyTable::kChains ? keys.chains[hit.key] : keys.stars[hit.key];
    if (stored.handedness * key->handedness < 0) continue;  // mirror images
    if (units_per_metre) {
      const double expected = static_cast<double>(stored.log_size) + std::log(*units_per_metre);
      if (std::abs(key->log_size - expected) > size_gate) continue;
    }
    TupleHit& out = hits->emplace_back();
    out.object = object;
    out.tuple = number;
    out.size = 4;
    for (int k = 0; k < 4; ++k) out.matches[k] = {stored.vertices[k], tuple.points[k]};
  }
  for (std::size_t i = first; i < hits->size(); ++i) {
    (*hits)[i].hits_of_tuple = static_cast<int>(hits->size() - first);
  }
  if (hits->size() > first + options.route.max_hits_per_tuple) hits->resize(first);
  return absl::OkStatus();
}

absl::StatusOr<StructureRouteResult> Search(const SceneStructure& structure,
                                            const StructureEvidence& evidence,
                                            const KeyIndexSnapshot& index,
                                            const MetricRouteOptions& options,
                                            const std::optional<double>& units_per_metre,
                                            const StopRequested& stop,
                                            ObjectTable* table) {
  StructureRouteResult result;
  result.components = StructureComponents(structure, options.route.components);
  for (std::size_t c = 0; c < result.components.size(); ++c) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped between components");
    const std::vector<FourTuple> tuples = TuplesOf(structure, result.components[c]);
    std::vector<TupleHit> hits;
    for (std::size_t t = 0; t < tuples.size(); ++t) {
      HOROPTER_RETURN_IF_ERROR(AskFor(tuples[t],
                                      static_cast<int>(t),
                                      structure,
                                      index,
                                      options,
                                      units_per_metre,
                                      *table,
                                      &hits));
    }
    result.counts["tuples"] += static_cast<double>(tuples.size());
    HOROPTER_RETURN_IF_ERROR(
        JudgeHits({TransformGroup::kSimilarity, evidence, options.route, stop, table},
                  {result.components[c], static_cast<int>(c)},
                  std::move(hits),
                  &result));
  }
  result.counts["components"] = static_cast<double>(result.components.size());
  SortHypotheses(&result.hypotheses);
  if (units_per_metre) {
    // Chains that are similar in shape and, within their deviations, in size.
    std::erase_if(result.hypotheses, [&](const StructureHypothesis& h) {
      return std::abs(std::log(UnitsPerMetre(h.structure_from_object) / *units_per_metre)) >
             2.0 * kScaleTolerance;
    });
  }
  return result;
}

}  // namespace

double UnitsPerMetre(const Eigen::Matrix4d& structure_from_object) {
  return std::cbrt(std::abs(structure_from_object.topLeftCorner<3, 3>().determinant())) /
         structure_from_object(3, 3);
}

absl::StatusOr<MetricRouteResult> MetricHypotheses(const SceneStructure& structure,
                                                   const KeyIndexSnapshot& index,
                                                   std::span<const StructureObject> objects,
                                                   const MetricRouteOptions& options,
                                                   const StopRequested& stop) {
  if (!structure.metric) return absl::InvalidArgumentError("structure: not metric");
  HOROPTER_ASSIGN_OR_RETURN(ObjectTable table, ObjectTable::Make(objects));
  const StructureEvidence evidence = GatherEvidence(structure);
  MetricRouteResult result;
  result.units_per_metre = options.units_per_metre;
  HOROPTER_ASSIGN_OR_RETURN(
      result.found,
      Search(structure, evidence, index, options, result.units_per_metre, stop, &table));
  if (result.units_per_metre || result.found.hypotheses.empty()) return result;
  const StructureHypothesis& best = result.found.hypotheses[0];
  if (best.log_odds < options.scale_log_odds) return result;
  result.units_per_metre = UnitsPerMetre(best.structure_from_object);
  HOROPTER_ASSIGN_OR_RETURN(
      result.found,
      Search(structure, evidence, index, options, result.units_per_metre, stop, &table));
  return result;
}

}  // namespace horopter
