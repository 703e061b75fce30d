#include "server/vision/recognition/invariant_matching/route_votes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/invariant_matching/mean_shift.h"

namespace horopter {
namespace {

// One hit of one tuple.
struct VertexVote {
  int object = -1;
  int tuple = -1;  // of which query; a tuple counts once in a mode
  std::vector<VertexMatch> matches;
  Eigen::Matrix4d structure_from_shape = Eigen::Matrix4d::Identity();
  double weight = 1.0;  // rarity of the key: 1 / hits of its query
  int support = 0;      // vertices with a point, by QuickVertexMatches
};

// Votes of one object that agree on where it is.
struct VoteMode {
  int object = -1;
  std::vector<int> members;  // indices into the votes
  double weight = 0.0;       // sum of the members' weights
  int tuples = 0;            // different queries among them
  int support = 0;           // largest of the members'
  Eigen::Matrix4d structure_from_shape = Eigen::Matrix4d::Identity();  // of the best member
};

// Bandwidths in extents of the object in the structure. Bounded: among scattered wrong votes a
// right one would have its neighbours far away and drown in their mode.
ClusterOptions VoteClusters() {
  ClusterOptions options;
  options.min_bandwidth = 0.02;
  options.max_bandwidth = 0.5;
  return options;
}

constexpr int kMaxVotes = 300;  // of one object, best supported first: the time is quadratic
// Pairs of the mode's table with less than this share of the largest entry are left out.
constexpr double kMinTableShare = 0.2;
// Corners of a tetrahedron about the centre, well inside the shape's unit sphere: the plane at
// infinity of a vote may come near the sphere.
constexpr double kCorner = 0.35;

// 15 coordinates: the images of the shape's centre and of four points around it. Not the entries of
// the matrix: a collineation moves points, and noise moves them alike in all of its parts.
Eigen::Matrix<double, 15, 1> VoteCoordinates(const Eigen::Matrix4d& structure_from_shape) {
  static const std::array<Eigen::Vector3d, 5> kPoints = {Eigen::Vector3d(0, 0, 0),
                                                         Eigen::Vector3d(1, 1, 1),
                                                         Eigen::Vector3d(1, -1, -1),
                                                         Eigen::Vector3d(-1, 1, -1),
                                                         Eigen::Vector3d(-1, -1, 1)};
  Eigen::Matrix<double, 15, 1> out;
  for (int k = 0; k < 5; ++k) {
    out.segment<3>(3 * k) =
        (structure_from_shape * Eigen::Vector4d((kCorner * kPoints[k]).homogeneous()))
            .hnormalized();
  }
  return out;
}

// All votes of one object; best supported mode first, then by weight. Errors: those of FindModes.
absl::StatusOr<std::vector<VoteMode>> ClusterVotes(std::span<const VertexVote> votes,
                                                   std::span<const int> of_object) {
  std::vector<int> kept;
  std::vector<Eigen::Matrix<double, 15, 1>> coordinates;
  std::vector<int> order(of_object.begin(), of_object.end());
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return votes[a].support > votes[b].support;
  });
  for (const int i : order) {
    if (static_cast<int>(kept.size()) >= kMaxVotes) break;
    const auto x = VoteCoordinates(votes[i].structure_from_shape);
    if (!x.allFinite()) continue;
    kept.push_back(i);
    coordinates.push_back(x);
  }
  if (kept.empty()) return std::vector<VoteMode>{};
  Eigen::MatrixXd points(15, kept.size());
  Eigen::VectorXd weights(kept.size());
  std::vector<double> extents;
  for (std::size_t k = 0; k < kept.size(); ++k) {
    points.col(static_cast<Eigen::Index>(k)) = coordinates[k];
    weights(static_cast<Eigen::Index>(k)) = votes[kept[k]].weight;
    extents.push_back((coordinates[k].segment<3>(3) - coordinates[k].head<3>()).norm());
  }
  std::nth_element(extents.begin(), extents.begin() + extents.size() / 2, extents.end());
  const double unit = std::max(1e-9, extents[extents.size() / 2]);
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<DensityMode> found,
                            FindModes(points / unit, weights, VoteClusters()));
  std::vector<VoteMode> modes;
  for (const DensityMode& mode : found) {
    VoteMode& out = modes.emplace_back();
    std::set<int> tuples;
    for (const int k : mode.members) {
      const VertexVote& vote = votes[kept[k]];
      out.members.push_back(kept[k]);
      tuples.insert(vote.tuple);
      if (out.members.size() == 1 || vote.support > out.support) {
        out.support = vote.support;
        out.structure_from_shape = vote.structure_from_shape;
      }
    }
    out.object = votes[out.members[0]].object;
    out.weight = mode.weight;
    out.tuples = static_cast<int>(tuples.size());
  }
  std::stable_sort(modes.begin(), modes.end(), [](const VoteMode& a, const VoteMode& b) {
    return a.support != b.support ? a.support > b.support : a.weight > b.weight;
  });
  return modes;
}

// Correspondences of a mode by its association table.
std::vector<VertexMatch> AssociateMode(std::span<const VertexVote> votes,
                                       const VoteMode& mode,
                                       int points,
                                       int vertices) {
  AssociationTable table(points, vertices);
  for (const int i : mode.members) table.Add(votes[i].matches, votes[i].weight);
  return table.Assign(kMinTableShare * table.votes().maxCoeff());
}

// Vertices beyond the tuple's own that must have a point near before a vote is clustered.
constexpr int kMinExtraSupport = 1;
constexpr double kQuickReach = 0.15;    // how near, of the object's extent
constexpr double kSettledReach = 0.06;  // ... after the transformation was fitted to all of them
constexpr int kStopStride = 256;        // votes between two looks at the stop token

// An object of which little is seen may be larger than what is seen.
constexpr double kMaxExtentRatio = 1.6;

// Root mean square distance of the points from their middle.
double ExtentOf(const SceneStructure& structure, std::span<const int> points) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  const auto n = static_cast<double>(points.size());
  for (const int i : points) mean += structure.points[i] / n;
  double sum = 0.0;
  for (const int i : points) sum += (structure.points[i] - mean).squaredNorm() / n;
  return std::sqrt(sum);
}

int VerticesOfTuple(TransformGroup group) {
  return group == TransformGroup::kCollineation ? 6 : 4;
}

absl::StatusOr<Eigen::Matrix4d> FitHit(TransformGroup group,
                                       const SceneStructure& structure,
                                       const ObjectShape& shape,
                                       const TupleHit& hit) {
  if (group != TransformGroup::kCollineation) {
    return FitTransform(group, structure, shape, std::span(hit.matches.data(), hit.size), {});
  }
  std::array<Eigen::Vector4d, 6> from, to;
  for (int k = 0; k < hit.size; ++k) {
    from[k] = shape.vertices[hit.matches[k].vertex].homogeneous();
    to[k] = structure.points[hit.matches[k].point].homogeneous();
  }
  HOROPTER_ASSIGN_OR_RETURN(
      const Eigen::Matrix4d H,
      CollineationFromBasis(std::span(from.data(), hit.size), std::span(to.data(), hit.size)));
  return H.row(3).dot(from[0]) < 0.0 ? Eigen::Matrix4d(-H) : H;
}

VoteMode WholeObject(std::span<const VertexVote> votes, std::span<const int> of_object) {
  VoteMode out;
  out.object = votes[of_object[0]].object;
  out.members.assign(of_object.begin(), of_object.end());
  out.tuples = static_cast<int>(of_object.size());
  for (const int i : of_object) {
    out.weight += votes[i].weight;
    if (votes[i].support <= out.support) continue;
    out.support = votes[i].support;
    out.structure_from_shape = votes[i].structure_from_shape;
  }
  return out;
}

bool SameMatches(const StructureHypothesis& a, const StructureHypothesis& b) {
  if (a.object != b.object || a.vertices.size() != b.vertices.size()) return false;
  return std::is_permutation(a.vertices.begin(), a.vertices.end(), b.vertices.begin());
}

// The vote of a hit, if enough vertices of the object have a point near.
std::optional<VertexVote> VoteOf(const HitJudge& judge,
                                 const HitComponent& component,
                                 double component_extent,
                                 const TupleHit& hit) {
  const SceneStructure& structure = *judge.evidence.structure;
  const ObjectShape& shape = judge.objects->shape(hit.object);
  const auto rough = FitHit(judge.group, structure, shape, hit);
  if (!rough.ok()) return std::nullopt;
  const double extent = MappedExtent(shape, *rough);
  // A transformation that spreads the object over everything has all points near some vertex.
  if (!(extent < kMaxExtentRatio * component_extent)) return std::nullopt;
  const int enough = VerticesOfTuple(judge.group) + kMinExtraSupport;
  const auto near = [&](const Eigen::Matrix4d& H, double reach) {
    return QuickVertexMatches(
        structure, component.points, shape, H, reach * std::min(extent, component_extent));
  };
  if (static_cast<int>(near(*rough, kQuickReach).size()) < enough) return std::nullopt;
  // A few points extrapolate badly: all that came near determine it better, and what is right
  // comes nearer then. Unless wrong ones were among them: then it stays as it was.
  Eigen::Matrix4d H = *rough;
  std::vector<VertexMatch> matches = near(H, kSettledReach);
  for (const double reach : {kQuickReach, kSettledReach}) {
    const auto fitted = FitTransform(judge.group, structure, shape, near(*rough, reach), {});
    if (!fitted.ok()) continue;
    std::vector<VertexMatch> again = near(*fitted, kSettledReach);
    if (again.size() <= matches.size()) continue;
    H = *fitted;
    matches = std::move(again);
  }
  const int support = static_cast<int>(matches.size());
  if (support < enough) return std::nullopt;
  return VertexVote{hit.object,
                    hit.tuple,
                    std::vector<VertexMatch>(hit.matches.begin(), hit.matches.begin() + hit.size),
                    H,
                    1.0 / hit.hits_of_tuple,
                    support};
}

// The modes that are judged, best first; then, beside the modes, every object's votes together:
// many are right in four or five of their vertices only, lie far from the truth, and still fill the
// right fields of the table.
absl::StatusOr<std::vector<VoteMode>> ModesOf(const HitJudge& judge,
                                              std::span<const VertexVote> votes,
                                              const std::vector<std::vector<int>>& of_object,
                                              StructureRouteResult* result) {
  std::vector<VoteMode> modes, whole;
  for (const std::vector<int>& list : of_object) {
    if (list.empty()) continue;
    if (IsStopRequested(judge.stop)) return absl::CancelledError("stopped");
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<VoteMode> of_one, ClusterVotes(votes, list));
    modes.insert(modes.end(), of_one.begin(), of_one.end());
    if (list.size() > 1) whole.push_back(WholeObject(votes, list));
  }
  // A query more in agreement says about as much as a vertex and a half.
  const auto promise = [](const VoteMode& m) { return m.support + 1.5 * std::log2(m.tuples); };
  std::stable_sort(modes.begin(), modes.end(), [&](const VoteMode& a, const VoteMode& b) {
    return promise(a) > promise(b);
  });
  result->counts["votes"] += static_cast<double>(votes.size());
  result->counts["modes"] += static_cast<double>(modes.size());
  if (static_cast<int>(modes.size()) > judge.options.judged_modes)
    modes.resize(judge.options.judged_modes);
  modes.insert(modes.end(), whole.begin(), whole.end());
  result->counts["judged"] += static_cast<double>(modes.size());
  return modes;
}

// The mode's best member, or what its association table says, whichever has more support.
StructureHypothesis BestOfMode(const HitJudge& judge,
                               std::span<const VertexVote> votes,
                               const VoteMode& mode) {
  const SceneStructure& structure = *judge.evidence.structure;
  const ObjectShape& shape = judge.objects->shape(mode.object);
  const auto judged = [&](const Eigen::Matrix4d& H) {
    StructureHypothesis h =
        JudgeTransform(judge.group, judge.evidence, shape, H, judge.options.support);
    h.object = mode.object;
    h.votes = mode.tuples;
    return h;
  };
  StructureHypothesis best = judged(mode.structure_from_shape);
  // The table of a single query says no more than that query.
  if (mode.tuples < 2) return best;
  const std::vector<VertexMatch> associated =
      AssociateMode(votes, mode, static_cast<int>(structure.points.size()), shape.size());
  ConsistencyOptions consistency = judge.options.consistency;
  consistency.reach = kQuickReach * MappedExtent(shape, mode.structure_from_shape);
  const auto agreed = FindConsistentMatches(judge.group, structure, shape, associated, consistency);
  if (!agreed.ok()) return best;
  StructureHypothesis other = judged(agreed->structure_from_shape);
  return other.log_odds > best.log_odds ? other : best;
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

absl::Status JudgeHits(const HitJudge& judge,
                       const HitComponent& component,
                       std::vector<TupleHit> hits,
                       StructureRouteResult* result) {
  std::stable_sort(hits.begin(), hits.end(), [](const TupleHit& a, const TupleHit& b) {
    return a.hits_of_tuple < b.hits_of_tuple;
  });
  result->counts["hits"] += static_cast<double>(hits.size());
  if (static_cast<int>(hits.size()) > judge.options.max_hits) hits.resize(judge.options.max_hits);
  const double extent = ExtentOf(*judge.evidence.structure, component.points);
  std::vector<VertexVote> votes;
  std::vector<std::vector<int>> of_object;
  for (std::size_t i = 0; i < hits.size(); ++i) {
    if (i % kStopStride == 0 && IsStopRequested(judge.stop)) return absl::CancelledError("stopped");
    auto vote = VoteOf(judge, component, extent, hits[i]);
    if (!vote) continue;
    if (vote->object >= static_cast<int>(of_object.size())) of_object.resize(vote->object + 1);
    of_object[vote->object].push_back(static_cast<int>(votes.size()));
    votes.push_back(*std::move(vote));
  }
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<VoteMode> modes,
                            ModesOf(judge, votes, of_object, result));
  std::vector<StructureHypothesis> found;
  for (const VoteMode& mode : modes) {
    if (IsStopRequested(judge.stop)) return absl::CancelledError("stopped");
    StructureHypothesis best = BestOfMode(judge, votes, mode);
    best.component = component.index;
    if (std::isfinite(best.log_odds)) found.push_back(std::move(best));
  }
  SortHypotheses(&found);
  if (static_cast<int>(found.size()) > judge.options.kept) found.resize(judge.options.kept);
  for (StructureHypothesis& h : found) result->hypotheses.push_back(std::move(h));
  return absl::OkStatus();
}

}  // namespace horopter
