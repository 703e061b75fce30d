#include "server/vision/matching/match_features.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "server/base/stop_scope.h"
#include "server/vision/matching/learnt_constants.h"
#include "server/vision/matching/similarity_bounds.h"

namespace horopter {
namespace {

constexpr double kMaxSupport = 8.0;  // of all neighbours together: they share their mistakes
// Least mean distance: nearer features change order by noise.
constexpr double kMinSeparationPx = 6.0;
constexpr int kFeaturesPerLook = 32;  // at the stop flag

using Candidates = std::vector<FeatureMatch>;

// The `keep` best of each a that are also among the `keep` best of their b.
Candidates KeepBest(const Candidates& all, int rows, int columns, int keep) {
  const auto ranks = [&](bool by_a, int groups) {
    std::vector<std::vector<int>> group(groups);
    for (size_t k = 0; k < all.size(); ++k)
      group[by_a ? all[k].a : all[k].b].push_back(static_cast<int>(k));
    std::vector<char> kept(all.size(), 0);
    for (std::vector<int>& g : group) {
      const size_t n = std::min<size_t>(g.size(), keep);
      std::partial_sort(g.begin(), g.begin() + n, g.end(), [&](int x, int y) {
        return all[x].log_ratio != all[y].log_ratio ? all[x].log_ratio > all[y].log_ratio : x < y;
      });
      for (size_t k = 0; k < n; ++k) kept[g[k]] = 1;
    }
    return kept;
  };
  const std::vector<char> of_a = ranks(true, rows), of_b = ranks(false, columns);
  Candidates kept;
  for (size_t k = 0; k < all.size(); ++k) {
    if (of_a[k] && of_b[k]) kept.push_back(all[k]);
  }
  return kept;
}

// Candidates of one kind that may be among the `keep` best of either feature. Only pairs whose
// bound allows that are compared; of every feature of view a the likeliest ones first, so that the
// others are soon seen to be out of reach.
class CandidateSearch {
 public:
  CandidateSearch(const PairComparison& pair, const FeatureMatchOptions& options)
      : pair_(pair), options_(options), bounds_(pair, options.similarity) {}

  Candidates Segments() const {
    return Search(
        FeatureKind::kSegment,
        pair_.a().features->segments.size(),
        pair_.b().features->segments.size(),
        [&](int a, std::vector<SimilarityBounds::Bound>* out) {
          bounds_.OfSegment(a, Least(), out);
        },
        [&](int a, int b) { return pair_.MaySegments(a, b); },
        [&](int a, int b) { return pair_.Segments(a, b); });
  }
  Candidates Junctions() const {
    return Search(
        FeatureKind::kJunction,
        pair_.a().features->junctions.size(),
        pair_.b().features->junctions.size(),
        [&](int a, std::vector<SimilarityBounds::Bound>* out) {
          bounds_.OfJunction(a, Least(), out);
        },
        [&](int a, int b) { return pair_.MayJunctions(a, b); },
        [&](int a, int b) { return pair_.Junctions(a, b); });
  }

 private:
  float Least() const { return static_cast<float>(options_.min_candidate); }

  template <typename Bounds, typename May, typename Compare>
  Candidates Search(FeatureKind kind,
                    size_t rows,
                    size_t columns,
                    const Bounds& bounds_of,
                    const May& may,
                    const Compare& compare) const {
    HighestSoFar highest(rows, columns, options_.per_feature, Least());
    std::vector<SimilarityBounds::Bound> bounds;
    Candidates found;
    StopPacer pacer(kFeaturesPerLook);
    for (size_t i = 0; i < rows; ++i) {
      pacer.Step();
      const int a = static_cast<int>(i);
      bounds_of(a, &bounds);
      const size_t first = std::min<size_t>(bounds.size(), 2 * options_.per_feature);
      std::partial_sort(bounds.begin(),
                        bounds.begin() + static_cast<std::ptrdiff_t>(first),
                        bounds.end(),
                        [](const auto& x, const auto& y) {
                          return x.log_ratio != y.log_ratio ? x.log_ratio > y.log_ratio : x.b < y.b;
                        });
      for (const SimilarityBounds::Bound& bound : bounds) {
        if (!highest.MayEnter(a, bound.b, bound.log_ratio) || !may(a, bound.b)) continue;
        const double ratio = LogRatio(compare(a, bound.b), pair_.has_plane(), options_.similarity);
        if (ratio < options_.min_candidate) continue;
        found.push_back({kind, a, bound.b, ratio});
        highest.Enter(a, bound.b, static_cast<float>(ratio));
      }
    }
    std::sort(found.begin(), found.end(), [](const FeatureMatch& x, const FeatureMatch& y) {
      return x.a != y.a ? x.a < y.a : x.b < y.b;
    });
    return KeepBest(found, static_cast<int>(rows), static_cast<int>(columns), options_.per_feature);
  }

  const PairComparison& pair_;
  const FeatureMatchOptions& options_;
  SimilarityBounds bounds_;
};

Candidates FindCandidates(const PairComparison& pair, const FeatureMatchOptions& options) {
  const CandidateSearch search(pair, options);
  Candidates found = search.Junctions();
  const Candidates segments = search.Segments();
  found.insert(found.end(), segments.begin(), segments.end());
  return found;
}

// Candidates by their feature in view a.
class ByFeature {
 public:
  explicit ByFeature(const Candidates& candidates) {
    for (size_t k = 0; k < candidates.size(); ++k)
      map_[Key(candidates[k].kind, candidates[k].a)].push_back(static_cast<int>(k));
  }
  const std::vector<int>& Of(FeatureKind kind, int a) const {
    static const std::vector<int> kNobody;
    const auto it = map_.find(Key(kind, a));
    return it == map_.end() ? kNobody : it->second;
  }

 private:
  static uint64_t Key(FeatureKind kind, int a) {
    return (static_cast<uint64_t>(kind) << 32) | static_cast<uint32_t>(a);
  }
  std::unordered_map<uint64_t, std::vector<int>> map_;
};

MatchRelation RelationOf(FeatureRelation relation) {
  switch (relation) {
    case FeatureRelation::kSharesJunction:
      return MatchRelation::kSegmentsShareJunction;
    case FeatureRelation::kCollinear:
      return MatchRelation::kSegmentsCollinear;
    case FeatureRelation::kParallel:
      return MatchRelation::kSegmentsParallel;
    case FeatureRelation::kSameRegion:
      return MatchRelation::kSegmentsSameRegion;
    default:
      return MatchRelation::kSegmentMeetsJunction;
  }
}

bool HasEdge(const FeatureGraph& graph, uint32_t from, uint32_t to, FeatureRelation relation) {
  for (const GraphEdge& e : graph.EdgesOf(from)) {
    if (e.node == to && e.relation == relation) return true;
  }
  return false;
}

class Linker {
 public:
  Linker(const PairComparison& pair, CandidateGraph* out)
      : pair_(pair), out_(out), by_feature_(out->candidates) {}

  void Run() {
    StopPacer pacer(kFeaturesPerLook);
    for (size_t k = 0; k < out_->candidates.size(); ++k) {
      pacer.Step();
      LinkNeighbours(static_cast<int>(k));
      if (out_->candidates[k].kind == FeatureKind::kSegment) LinkEnds(static_cast<int>(k));
    }
  }

 private:
  // Neighbours in both graphs by one relation.
  void LinkNeighbours(int k) {
    const FeatureMatch& c = out_->candidates[k];
    const uint32_t node_a = pair_.a().graph.Node(c.kind, c.a);
    const uint32_t node_b = pair_.b().graph.Node(c.kind, c.b);
    for (const GraphEdge& e : pair_.a().graph.EdgesOf(node_a)) {
      if (e.relation == FeatureRelation::kChordOf) continue;
      const FeatureKind kind = pair_.a().graph.KindOf(e.node);
      if (kind != FeatureKind::kSegment && kind != FeatureKind::kJunction) continue;
      for (int other : by_feature_.Of(kind, pair_.a().graph.IndexOf(e.node))) {
        if (other <= k) continue;  // each link once
        const FeatureMatch& o = out_->candidates[other];
        if (o.kind == c.kind && o.b == c.b) continue;
        const uint32_t other_b = pair_.b().graph.Node(o.kind, o.b);
        if (!HasEdge(pair_.b().graph, node_b, other_b, e.relation)) continue;
        float disagreement = 0.0f;
        if (c.kind == FeatureKind::kSegment && kind == FeatureKind::kSegment)
          disagreement = static_cast<float>(
              std::abs(std::remainder(SignedTurn(c) - SignedTurn(o), 2.0 * M_PI)));
        out_->links.push_back({k, other, RelationOf(e.relation), disagreement});
      }
    }
  }

  // Junctions at the two ends of a matched segment.
  void LinkEnds(int k) {
    const FeatureMatch& c = out_->candidates[k];
    const std::vector<int> ends_a = JunctionsOf(pair_.a().graph, c.a);
    const std::vector<int> ends_b = JunctionsOf(pair_.b().graph, c.b);
    std::vector<int> matches;
    for (int j : ends_a) {
      for (int m : by_feature_.Of(FeatureKind::kJunction, j)) {
        if (std::count(ends_b.begin(), ends_b.end(), out_->candidates[m].b)) matches.push_back(m);
      }
    }
    for (size_t x = 0; x < matches.size(); ++x) {
      for (size_t y = x + 1; y < matches.size(); ++y) {
        const FeatureMatch& m = out_->candidates[matches[x]];
        const FeatureMatch& n = out_->candidates[matches[y]];
        if (m.a == n.a || m.b == n.b) continue;
        out_->links.push_back({std::min(matches[x], matches[y]),
                               std::max(matches[x], matches[y]),
                               MatchRelation::kJunctionsOfOneSegment,
                               DisplacementGradient(m, n)});
      }
    }
  }

  static std::vector<int> JunctionsOf(const FeatureGraph& graph, int segment) {
    std::vector<int> junctions;
    for (const GraphEdge& e : graph.EdgesOf(graph.Node(FeatureKind::kSegment, segment))) {
      if (e.relation == FeatureRelation::kMeetsAt && graph.KindOf(e.node) == FeatureKind::kJunction)
        junctions.push_back(graph.IndexOf(e.node));
    }
    return junctions;
  }

  double SignedTurn(const FeatureMatch& m) const {
    const Segment& a = pair_.a().features->segments[m.a];
    const Segment& b = pair_.b().features->segments[m.b];
    const Eigen::Vector2d u = pair_.Warp(a.end) - pair_.Warp(a.start), v = b.end - b.start;
    return std::atan2(u.x() * v.y() - u.y() * v.x(), u.dot(v));
  }

  float DisplacementGradient(const FeatureMatch& m, const FeatureMatch& n) const {
    const auto& ja = pair_.a().features->junctions;
    const auto& jb = pair_.b().features->junctions;
    const Eigen::Vector2d pm = pair_.Warp(ja[m.a].point), pn = pair_.Warp(ja[n.a].point);
    const Eigen::Vector2d before = pn - pm, after = jb[n.b].point - jb[m.b].point;
    // Over the mean of both distances: 2 is where the order changes (Pollard et al. 1985).
    const double mean = std::max(kMinSeparationPx, 0.5 * (before.norm() + after.norm()));
    return static_cast<float>((after - before).norm() / mean);
  }

  const PairComparison& pair_;
  CandidateGraph* out_;
  ByFeature by_feature_;
};

double SupportOf(const MatchCandidateLink& link, bool has_plane, bool transformations) {
  const LogRatioTable& t = kLinkTables[has_plane ? 0 : 1][static_cast<int>(link.relation)];
  if (!transformations) return t.weight;
  return std::max(0.0, TableValue(t, link.disagreement));
}

AssignmentProblem MakeProblem(const CandidateGraph& graph,
                              const std::vector<double>& support,
                              int segments_a,
                              int segments_b) {
  AssignmentProblem problem;
  for (const FeatureMatch& c : graph.candidates) {
    const bool junction = c.kind == FeatureKind::kJunction;
    problem.row.push_back(junction ? segments_a + c.a : c.a);
    problem.column.push_back(junction ? segments_b + c.b : c.b);
    problem.self.push_back(static_cast<float>(std::max(0.0, c.log_ratio)));
  }
  const size_t n = graph.candidates.size();
  std::vector<int> degree(n, 0);
  for (size_t k = 0; k < graph.links.size(); ++k) {
    if (support[k] <= 0.0) continue;
    ++degree[graph.links[k].from];
    ++degree[graph.links[k].to];
  }
  problem.begin.assign(n + 1, 0);
  for (size_t i = 0; i < n; ++i) problem.begin[i + 1] = problem.begin[i] + degree[i];
  problem.to.resize(problem.begin[n]);
  problem.weight.resize(problem.begin[n]);
  std::vector<int> next(problem.begin.begin(), problem.begin.end() - 1);
  for (size_t k = 0; k < graph.links.size(); ++k) {
    if (support[k] <= 0.0) continue;
    const MatchCandidateLink& l = graph.links[k];
    for (const auto& [from, to] : {std::pair(l.from, l.to), std::pair(l.to, l.from)}) {
      problem.to[next[from]] = to;
      problem.weight[next[from]++] = static_cast<float>(support[k]);
    }
  }
  return problem;
}

}  // namespace

absl::Status Validate(const FeatureMatchOptions& options) {
  if (options.per_feature < 1 || options.per_feature > 100)
    return absl::InvalidArgumentError("feature matching: per_feature must be 1 to 100");
  if (!std::isfinite(options.min_candidate) || !std::isfinite(options.min_accepted))
    return absl::InvalidArgumentError("feature matching: log-likelihood ratios must be finite");
  if (options.assignment.iterations < 1 || !(options.assignment.reweighting >= 0.0) ||
      !(options.assignment.reweighting <= 1.0) || !(options.assignment.inflation > 0.0))
    return absl::InvalidArgumentError(
        "feature matching: iterations >= 1, reweighting in [0, 1] and inflation > 0 required");
  return absl::OkStatus();
}

CandidateGraph BuildCandidateGraph(const PairComparison& pair, const FeatureMatchOptions& options) {
  CandidateGraph graph;
  graph.candidates = FindCandidates(pair, options);
  Linker(pair, &graph).Run();
  return graph;
}

std::vector<FeatureMatch> MatchFeatures(const PairComparison& pair,
                                        const FeatureMatchOptions& options) {
  CandidateGraph graph;
  const bool greedy = options.assignment.method == AssignmentMethod::kGreedy;
  if (greedy) {
    graph.candidates = FindCandidates(pair, options);
  } else {
    graph = BuildCandidateGraph(pair, options);
  }
  std::vector<double> support;
  for (const MatchCandidateLink& l : graph.links)
    support.push_back(SupportOf(l, pair.has_plane(), options.transformations));
  const AssignmentProblem problem =
      MakeProblem(graph,
                  support,
                  static_cast<int>(pair.a().features->segments.size()),
                  static_cast<int>(pair.b().features->segments.size()));
  const std::vector<int> taken = Discretize(problem, Confidences(problem, options.assignment));
  std::vector<char> accepted(graph.candidates.size(), 0);
  for (int k : taken) accepted[k] = 1;
  std::vector<double> from_neighbours(graph.candidates.size(), 0.0);
  for (size_t k = 0; k < graph.links.size(); ++k) {
    const MatchCandidateLink& l = graph.links[k];
    if (!accepted[l.from] || !accepted[l.to]) continue;
    from_neighbours[l.from] += support[k];
    from_neighbours[l.to] += support[k];
  }
  std::vector<FeatureMatch> matches;
  for (size_t k = 0; k < graph.candidates.size(); ++k) {
    if (!accepted[k]) continue;
    FeatureMatch match = graph.candidates[k];
    match.log_ratio += std::min(kMaxSupport, from_neighbours[k]);
    if (match.log_ratio >= options.min_accepted) matches.push_back(match);
  }
  return matches;
}

}  // namespace horopter
