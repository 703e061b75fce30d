// A view as the metric adjustment changes it.
#pragma once

#include <Eigen/Core>

#include "server/vision/geometry/pinhole_camera.h"

namespace horopter {

// Parameters of a view: rotation vector and translation (see pose_perturbation.h, of
// camera_from_scene), log f, cx, cy, k1.
inline constexpr int kViewParameters = 10;
using ViewJacobian = Eigen::Matrix<double, 2, kViewParameters>;

inline constexpr double kMinDepthM = 1e-4;    // what is nearer is behind its camera
inline constexpr double kBehindSigmas = 1e4;  // stands for the residual of such a point

// Pixel of a point in the camera frame, with derivatives by the point and by all parameters of the
// view (arm: the point minus camera_from_scene's translation, which rotates).
Eigen::Vector2d ProjectWithJacobian(const PinholeCamera& camera,
                                    const Eigen::Vector3d& p,
                                    const Eigen::Vector3d& arm,
                                    Eigen::Matrix<double, 2, 3>* by_point,
                                    ViewJacobian* by_view);

// Cauchy's loss of a squared residual in sigmas that begins to count less at `sigmas`, and its
// weight.
double CauchyLoss(double sigmas, double squared);
double RobustWeight(double sigmas, double squared);

}  // namespace horopter
