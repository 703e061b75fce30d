// Which vertex is which point: the fault-tolerant association table of the thesis
// (4.4).
#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/invariant_matching/object_collineation.h"

namespace horopter {

// How the points of one tuple are paired with the vertices of a stored one.
enum class AssociationForm {
  // The labeling in which the two keys agree says it: associated points in their cyclic order.
  kCyclicOrder,
  // The thesis's: equal invariants of two axes vote for their four pairs of points.
  kAxes,
};

// Six points to six vertices by their axis invariants: result[i] is the vertex of points[i].
// tolerance: of two folded angles, radians. Errors: INVALID_ARGUMENT (not finite).
absl::StatusOr<std::array<int, 6>> AssociateByAxes(std::span<const Eigen::Vector4d, 6> points,
                                                   std::span<const Eigen::Vector4d, 6> vertices,
                                                   double tolerance);

// How much speaks for each pair of a point and a vertex; rows are the structure's points. Votes of
// several tuples add up, so that wrong ones, missing vertices and clutter are outvoted.
class AssociationTable {
 public:
  AssociationTable(int points, int vertices) : votes_(Eigen::MatrixXd::Zero(points, vertices)) {}

  void Add(std::span<const VertexMatch> pairs, double weight);
  const Eigen::MatrixXd& votes() const { return votes_; }

  // The one-to-one assignment of largest total; pairs with less than `min_votes` are left out.
  // Most votes first.
  std::vector<VertexMatch> Assign(double min_votes) const;

 private:
  Eigen::MatrixXd votes_;
};

// Columns of rows that maximise the sum of value(row, column); -1: none. Values >= 0; pairs of
// value zero are not assigned. Hungarian algorithm, cubic.
std::vector<int> MaximumAssignment(const Eigen::MatrixXd& value);

// The largest set of the pairs that one transformation explains, found from the best supported
// ones; the others are wrong. Errors: those of FitTransform.
struct ConsistentMatches {
  Eigen::Matrix4d structure_from_shape = Eigen::Matrix4d::Identity();
  std::vector<VertexMatch> matches;
};
struct ConsistencyOptions {
  double reach = 0.06;  // of a mapped vertex from its point, structure units
  int draws = 100;
  unsigned seed = 1;
};
absl::StatusOr<ConsistentMatches> FindConsistentMatches(TransformGroup group,
                                                        const SceneStructure& structure,
                                                        const ObjectShape& shape,
                                                        std::span<const VertexMatch> pairs,
                                                        const ConsistencyOptions& options);

}  // namespace horopter
