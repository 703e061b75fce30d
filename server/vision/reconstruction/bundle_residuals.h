// Residuals of the bundles and their derivatives. All in units of the observation's sigma; not
// finite where the projection is not.
#pragma once

#include <Eigen/Core>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/projection.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/reconstruction/bundle_manifolds.h"
#include "server/vision/reconstruction/bundle_solver.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

using FeatureJacobian = Eigen::Matrix<double, 2, kFeatureParameters>;

// A residual and its derivatives by the C parameters of the camera and the four of the feature: the
// homogeneous point, or how both points of a line's span move along its complement N (MoveLine).
template <int C>
struct Linearized {
  Eigen::Vector2d r;
  Eigen::Matrix<double, 2, C> J_camera;
  FeatureJacobian J_feature;
};

// Projective camera: the rows of P one after the other.
inline constexpr int kProjectiveCamera = 12;
// (P X)_{x, y} / (P X)_z - observed.
Eigen::Vector2d Residual(const PointObservation& o,
                         const CameraMatrix& P,
                         const Eigen::Vector4d& X);
// Signed distances of both ends from (P A) x (P B).
Eigen::Vector2d Residual(const LineObservation& o, const CameraMatrix& P, const LineSpan& X);
Linearized<kProjectiveCamera> Linearize(const PointObservation& o,
                                        const CameraMatrix& P,
                                        const Eigen::Vector4d& X);
Linearized<kProjectiveCamera> Linearize(const LineObservation& o,
                                        const CameraMatrix& P,
                                        const LineSpan& X,
                                        const LineSpan& N);

// Metric camera: rotation increment w (R <- exp(w) R), translation, log f, cx, cy, k1.
inline constexpr int kMetricCamera = 10;
inline constexpr int kLogFocal = 6;
inline constexpr int kRadial = 9;
CalibratedCamera MoveCamera(const CalibratedCamera& camera,
                            const Eigen::Matrix<double, kMetricCamera, 1>& step);
Eigen::Vector2d Residual(const PointObservation& o,
                         const CalibratedCamera& view,
                         const Eigen::Vector4d& X);
// The observed ends are undistorted, so that the projected line is straight.
Eigen::Vector2d Residual(const LineObservation& o, const CalibratedCamera& view, const LineSpan& X);
Linearized<kMetricCamera> Linearize(const PointObservation& o,
                                    const CalibratedCamera& view,
                                    const Eigen::Vector4d& X);
Linearized<kMetricCamera> Linearize(const LineObservation& o,
                                    const CalibratedCamera& view,
                                    const LineSpan& X,
                                    const LineSpan& N);

// A pose known beforehand: rotation about the given one, then centre -R^T t about the given one.
struct PosePrior {
  Rigid3 camera_from_world;
  double rotation_sigma_rad = 0.01;
  double position_sigma_m = 0.005;
};
Eigen::Matrix<double, 6, 1> Residual(const PosePrior& prior, const Rigid3& camera_from_world);
// By w and t.
Eigen::Matrix<double, 6, 6> Jacobian(const PosePrior& prior, const Rigid3& camera_from_world);

}  // namespace horopter
