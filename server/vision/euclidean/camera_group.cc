#include "server/vision/euclidean/camera_group.h"

#include <cmath>

#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {

Eigen::VectorXd GroupOffset(const CameraGroup& group, std::span<const AdjustedView> views) {
  const int n = static_cast<int>(group.views.size());
  Eigen::VectorXd out = Eigen::VectorXd::Zero(kGroupParameters * n);
  if (n == 0) return out;
  const Rigid3 scene_from_anchor = views[group.views[0]].camera_from_scene.Inverse();
  for (int i = 0; i < n; ++i) {
    const AdjustedView& view = views[group.views[i]];
    auto d = out.segment<kGroupParameters>(kGroupParameters * i);
    if (i > 0) {
      d.head<6>() = PerturbationBetween(group.camera_from_anchor[i],
                                        view.camera_from_scene * scene_from_anchor);
    }
    const PinholeCamera& mean = group.cameras[i];
    d.tail<4>() << std::log(view.camera.focal_px / mean.focal_px), view.camera.cx - mean.cx,
        view.camera.cy - mean.cy, view.camera.k1 - mean.k1;
  }
  return out;
}

// camera_from_anchor = camera_from_scene * (anchor_from_scene)^-1.
Eigen::MatrixXd GroupJacobian(const CameraGroup& group, std::span<const AdjustedView> views) {
  const int n = static_cast<int>(group.views.size());
  Eigen::MatrixXd J = Eigen::MatrixXd::Identity(kGroupParameters * n, kGroupParameters * n);
  if (n == 0) return J;
  const Rigid3& anchor = views[group.views[0]].camera_from_scene;
  const Rigid3 scene_from_anchor = anchor.Inverse();
  const Matrix6d by_anchor = InInverse(anchor);
  J.topLeftCorner<6, 6>().setZero();
  for (int i = 1; i < n; ++i) {
    const Rigid3& pose = views[group.views[i]].camera_from_scene;
    const int row = kGroupParameters * i;
    J.block<6, 6>(row, row) = FirstInProduct(pose, scene_from_anchor);
    J.block<6, 6>(row, 0) = SecondInProduct(pose) * by_anchor;
  }
  return J;
}

double GroupCost(const CameraGroupPrior& prior, std::span<const AdjustedView> views) {
  if (prior.group.views.empty()) return 0.0;
  const Eigen::VectorXd d = GroupOffset(prior.group, views);
  return d.dot(prior.information * d);
}

void AddGroupPrior(const CameraGroupPrior& prior,
                   std::span<const AdjustedView> views,
                   std::span<const int> at,
                   Eigen::MatrixXd* A,
                   Eigen::VectorXd* b) {
  const int n = static_cast<int>(prior.group.views.size());
  if (n == 0) return;
  const Eigen::MatrixXd J = GroupJacobian(prior.group, views);
  const Eigen::MatrixXd weighted = J.transpose() * prior.information;
  const Eigen::MatrixXd H = weighted * J;
  const Eigen::VectorXd g = weighted * GroupOffset(prior.group, views);
  constexpr int k = kGroupParameters;
  for (int i = 0; i < n; ++i) {
    const int row = at[prior.group.views[i]];
    if (b != nullptr) b->segment<k>(row) += g.segment<k>(k * i);
    for (int j = 0; j < n; ++j)
      A->block<k, k>(row, at[prior.group.views[j]]) += H.block<k, k>(k * i, k * j);
  }
}

}  // namespace horopter
