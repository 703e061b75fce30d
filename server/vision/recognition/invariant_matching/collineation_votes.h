// Many tuples say where an object is, each badly: votes for transformations, clustered so that
// evidence adds up (thesis 4.4, appendix F).
#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/invariant_matching/association.h"
#include "server/vision/recognition/invariant_matching/mean_shift.h"
#include "server/vision/recognition/invariant_matching/object_collineation.h"

namespace horopter {

// One hit of one tuple.
struct VertexVote {
  int object = -1;
  int tuple = -1;  // of which query; a tuple counts once in a mode
  std::vector<VertexMatch> matches;
  Eigen::Matrix4d structure_from_shape = Eigen::Matrix4d::Identity();
  double weight = 1.0;  // rarity of the key: 1 / hits of its query
  int support = 0;      // vertices with a point, by QuickVertexMatches
};

// Bandwidths in extents of the object in the structure. Bounded: among scattered wrong votes a
// right one would have its neighbours far away and drown in their mode.
inline ClusterOptions VoteClusters() {
  ClusterOptions options;
  options.min_bandwidth = 0.02;
  options.max_bandwidth = 0.5;
  return options;
}

struct VoteOptions {
  ClusterOptions cluster = VoteClusters();
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

// 15 coordinates: the images of the shape's centre and of four points around it. Not the entries of
// the matrix: a collineation moves points, and noise moves them alike in all of its parts.
Eigen::Matrix<double, 15, 1> VoteCoordinates(const Eigen::Matrix4d& structure_from_shape);

// All votes of one object; best supported mode first, then by weight. Errors: those of FindModes.
absl::StatusOr<std::vector<VoteMode>> ClusterVotes(std::span<const VertexVote> votes,
                                                   std::span<const int> of_object,
                                                   const VoteOptions& options);

// Correspondences of a mode by its association table.
std::vector<VertexMatch> AssociateMode(std::span<const VertexVote> votes,
                                       const VoteMode& mode,
                                       int points,
                                       int vertices);

}  // namespace horopter
