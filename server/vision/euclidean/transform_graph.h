// The transformation graph of a robot cell (thesis 5.4): frames joined by transforms that are known
// up to a joint covariance; any pose in any frame, with covariance and correlations.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {

// How a transform that closes a loop disagrees with the path that was there.
struct LoopGap {
  Vector6d gap = Vector6d::Zero();  // perturbation from the path to the given transform
  Matrix6d covariance = Matrix6d::Zero();
  double chi_square = 0.0;  // gap' covariance^-1 gap, six degrees of freedom
};

// A tree of frames. Perturbations of all uncertain transforms share one covariance matrix: a
// transform says in which six columns its perturbation stands, so that correlations cancel where
// they should. Example:
//   TransformGraph graph;
//   const int base = graph.AddFrame("base"), part = graph.AddFrame("part");
//   graph.Connect(base, part, base_from_part, graph.AddUncertainty(covariance));
class TransformGraph {
 public:
  static constexpr int kExact = -1;  // no column: the pose is certain

  int AddFrame(std::string name);
  // Extends the covariance by a block that is independent of the rest; its first column.
  int AddUncertainty(const Eigen::MatrixXd& covariance);
  // Errors: INVALID_ARGUMENT (no such frame or columns, not finite), ALREADY_EXISTS (a path is
  // there: see Gap).
  absl::Status Connect(int a, int b, const Rigid3& a_from_b, int column = kExact);

  // Errors of all: NOT_FOUND (no path, no such frame).
  absl::StatusOr<UncertainPose> Between(int a, int b) const;  // a_from_b
  // Of the perturbation of a_from_b (rows) with that of c_from_d (columns).
  absl::StatusOr<Matrix6d> CrossCovariance(int a, int b, int c, int d) const;
  absl::StatusOr<LoopGap> Gap(int a, int b, const Rigid3& a_from_b, int column = kExact) const;

  int frames() const { return static_cast<int>(names_.size()); }
  const std::string& name(int frame) const { return names_[frame]; }

 private:
  struct Edge {
    int to = -1;
    Rigid3 pose;  // this_from_to
    int column = kExact;
    bool forward = true;  // the columns are of this pose; otherwise of its inverse
  };
  // The pose along a path and what each transform's perturbation does to it.
  struct Path {
    Rigid3 pose;
    std::vector<std::pair<int, Matrix6d>> parts;  // first column, Jacobian
  };
  absl::StatusOr<Path> Find(int a, int b) const;
  Matrix6d Covariance(const Path& p, const Path& q) const;
  bool IsFrame(int f) const { return f >= 0 && f < frames(); }

  std::vector<std::string> names_;
  std::vector<std::vector<Edge>> edges_;
  Eigen::MatrixXd covariance_;
};

}  // namespace horopter
