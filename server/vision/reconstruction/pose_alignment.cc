#include "server/vision/reconstruction/pose_alignment.h"

#include <Eigen/Dense>

#include "server/vision/geometry/collineation.h"

namespace horopter {

void AlignToPoses(std::span<const ViewPrior> priors, CalibratedScene* scene) {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Zero();
  std::vector<Eigen::Vector3d> from, to;
  for (size_t v = 0; v < priors.size(); ++v) {
    if (!priors[v].camera_from_world || !scene->views[v]) continue;
    const Rigid3& given = *priors[v].camera_from_world;
    const Rigid3& found = scene->views[v]->camera_from_scene;
    turn += given.R.transpose() * found.R;
    from.push_back(found.Inverse().t);
    to.push_back(given.Inverse().t);
  }
  if (from.empty()) return;
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(turn, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d signs = Eigen::Vector3d::Ones();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0) signs(2) = -1.0;
  const Eigen::Matrix3d R = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  Eigen::Vector3d mean_from = Eigen::Vector3d::Zero(), mean_to = mean_from;
  for (size_t k = 0; k < from.size(); ++k) {
    mean_from += from[k] / static_cast<double>(from.size());
    mean_to += to[k] / static_cast<double>(from.size());
  }
  double along = 0.0, squared = 0.0;
  for (size_t k = 0; k < from.size(); ++k) {
    const Eigen::Vector3d d = R * (from[k] - mean_from);
    along += d.dot(to[k] - mean_to);
    squared += d.squaredNorm();
  }
  double scale = 1.0;
  if (from.size() > 1) {
    scale = along / squared;
    if (!(scale > 0.0) || !std::isfinite(scale)) return;
  }
  const Eigen::Vector3d t = mean_to - scale * R * mean_from;
  Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
  H.topLeftCorner<3, 3>() = scale * R;
  H.topRightCorner<3, 1>() = t;
  for (auto& x : scene->points) {
    if (x) x = Eigen::Vector3d(scale * (R * *x) + t);
  }
  for (auto& line : scene->lines) {
    if (line) line = MapLine(H, *line).normalized();
  }
  for (auto& view : scene->views) {
    if (!view) continue;
    Rigid3& pose = view->camera_from_scene;
    pose.R = pose.R * R.transpose();
    pose.t = scale * pose.t - pose.R * t;
  }
}

}  // namespace horopter
