#include "server/vision/recognition/invariant_matching/collineation_votes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kMaxVotes = 300;  // of one object, best supported first: the time is quadratic
// Pairs of the mode's table with less than this share of the largest entry are left out.
constexpr double kMinTableShare = 0.2;
// Corners of a tetrahedron about the centre, well inside the shape's unit sphere: the plane at
// infinity of a vote may come near the sphere.
constexpr double kCorner = 0.35;

}  // namespace

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

absl::StatusOr<std::vector<VoteMode>> ClusterVotes(std::span<const VertexVote> votes,
                                                   std::span<const int> of_object,
                                                   const VoteOptions& options) {
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
                            FindModes(points / unit, weights, options.cluster));
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

std::vector<VertexMatch> AssociateMode(std::span<const VertexVote> votes,
                                       const VoteMode& mode,
                                       int points,
                                       int vertices) {
  AssociationTable table(points, vertices);
  for (const int i : mode.members) table.Add(votes[i].matches, votes[i].weight);
  return table.Assign(kMinTableShare * table.votes().maxCoeff());
}

}  // namespace horopter
