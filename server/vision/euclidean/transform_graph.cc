#include "server/vision/euclidean/transform_graph.h"

#include <Eigen/LU>
#include <algorithm>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {

int TransformGraph::AddFrame(std::string name) {
  names_.push_back(std::move(name));
  edges_.emplace_back();
  return frames() - 1;
}

int TransformGraph::AddUncertainty(const Eigen::MatrixXd& covariance) {
  const Eigen::Index n = covariance_.rows(), m = covariance.rows();
  Eigen::MatrixXd joint = Eigen::MatrixXd::Zero(n + m, n + m);
  joint.topLeftCorner(n, n) = covariance_;
  joint.bottomRightCorner(m, m) = covariance;
  covariance_ = std::move(joint);
  return static_cast<int>(n);
}

absl::Status TransformGraph::Connect(int a, int b, const Rigid3& a_from_b, int column) {
  if (!IsFrame(a) || !IsFrame(b) || a == b) {
    return absl::InvalidArgumentError(absl::StrCat("no two frames ", a, " and ", b));
  }
  if (column != kExact && (column < 0 || column + 6 > covariance_.rows())) {
    return absl::InvalidArgumentError(absl::StrCat("no uncertainty at column ", column));
  }
  if (!a_from_b.R.allFinite() || !a_from_b.t.allFinite()) {
    return absl::InvalidArgumentError(absl::StrCat(names_[a], " from ", names_[b], ": not finite"));
  }
  if (Find(a, b).ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat(names_[a], " and ", names_[b], " are connected already"));
  }
  edges_[a].push_back({b, a_from_b, column, true});
  edges_[b].push_back({a, a_from_b.Inverse(), column, false});
  return absl::OkStatus();
}

absl::StatusOr<TransformGraph::Path> TransformGraph::Find(int a, int b) const {
  if (!IsFrame(a) || !IsFrame(b)) return absl::NotFoundError("no such frame");
  // Breadth first from a; a tree has one path.
  std::vector<int> from(names_.size(), -1), edge(names_.size(), -1), queue{a};
  from[a] = a;
  for (std::size_t i = 0; i < queue.size() && from[b] < 0; ++i) {
    const int f = queue[i];
    for (std::size_t e = 0; e < edges_[f].size(); ++e) {
      const int to = edges_[f][e].to;
      if (from[to] >= 0) continue;
      from[to] = f;
      edge[to] = static_cast<int>(e);
      queue.push_back(to);
    }
  }
  if (from[b] < 0) {
    return absl::NotFoundError(absl::StrCat("nothing connects ", names_[a], " and ", names_[b]));
  }
  Path path;
  for (int f = b; f != a; f = from[f]) {
    const Edge& e = edges_[from[f]][edge[f]];
    // path.pose is f_from_b so far; the new one goes before it.
    const Matrix6d of_new = FirstInProduct(e.pose, path.pose), of_old = SecondInProduct(e.pose);
    for (auto& part : path.parts) part.second = of_old * part.second;
    if (e.column != kExact) {
      const Matrix6d own = e.forward ? Matrix6d(Matrix6d::Identity()) : InInverse(e.pose.Inverse());
      path.parts.push_back({e.column, of_new * own});
    }
    path.pose = e.pose * path.pose;
  }
  return path;
}

Matrix6d TransformGraph::Covariance(const Path& p, const Path& q) const {
  Matrix6d out = Matrix6d::Zero();
  for (const auto& [row, Jp] : p.parts) {
    for (const auto& [column, Jq] : q.parts) {
      out += Jp * covariance_.block<6, 6>(row, column) * Jq.transpose();
    }
  }
  return out;
}

absl::StatusOr<UncertainPose> TransformGraph::Between(int a, int b) const {
  HOROPTER_ASSIGN_OR_RETURN(const Path path, Find(a, b));
  const Matrix6d covariance = Covariance(path, path);
  return UncertainPose{path.pose, 0.5 * (covariance + covariance.transpose())};
}

absl::StatusOr<Matrix6d> TransformGraph::CrossCovariance(int a, int b, int c, int d) const {
  HOROPTER_ASSIGN_OR_RETURN(const Path first, Find(a, b));
  HOROPTER_ASSIGN_OR_RETURN(const Path second, Find(c, d));
  return Covariance(first, second);
}

absl::StatusOr<LoopGap> TransformGraph::Gap(int a,
                                            int b,
                                            const Rigid3& a_from_b,
                                            int column) const {
  HOROPTER_ASSIGN_OR_RETURN(const Path path, Find(a, b));
  if (column != kExact && (column < 0 || column + 6 > covariance_.rows())) {
    return absl::NotFoundError(absl::StrCat("no uncertainty at column ", column));
  }
  LoopGap out;
  out.gap = PerturbationBetween(path.pose, a_from_b);
  Path difference = path;
  if (column != kExact) difference.parts.push_back({column, -Matrix6d::Identity()});
  out.covariance = Covariance(difference, difference);
  out.chi_square = out.gap.dot(out.covariance.fullPivLu().solve(out.gap));
  return out;
}

}  // namespace horopter
