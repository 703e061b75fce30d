#include "server/vision/reconstruction/bundle_residuals.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>

#include "server/vision/geometry/plucker_line.h"

namespace horopter {
namespace {

constexpr int kUndistortions = 8;  // fixed-point rounds; distortion is weak

// Distance d of x from l = p x q, |l_xy| = norm, through p and q: d is linear in l / norm, and
// x . (dp x q) = dp . (q x x).
struct LineGradient {
  double distance;
  Eigen::Vector3d by_p, by_q;
};
LineGradient DistanceGradient(const Eigen::Vector3d& p,
                              const Eigen::Vector3d& q,
                              const Eigen::Vector3d& l,
                              double norm,
                              const Eigen::Vector2d& x) {
  LineGradient out;
  out.distance = l.dot(x.homogeneous()) / norm;
  Eigen::Vector3d g = x.homogeneous() / norm;
  g.head<2>() -= l.head<2>() * (out.distance / (norm * norm));
  out.by_p = q.cross(g);
  out.by_q = g.cross(p);
  return out;
}

// Normalised place of a pixel, distortion undone.
Eigen::Vector2d Undistorted(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d d = (pixel - Eigen::Vector2d(camera.cx, camera.cy)) / camera.focal_px;
  Eigen::Vector2d x = d;
  if (camera.k1 == 0.0) return x;
  for (int i = 0; i < kUndistortions; ++i) x = d / (1.0 + camera.k1 * x.squaredNorm());
  return x;
}

// (1 + k1 |x|^2) x by x.
Eigen::Matrix2d DistortionJacobian(const PinholeCamera& camera, const Eigen::Vector2d& x) {
  Eigen::Matrix2d D = 2.0 * camera.k1 * x * x.transpose();
  D.diagonal().array() += 1.0 + camera.k1 * x.squaredNorm();
  return D;
}

}  // namespace

Eigen::Vector2d Residual(const PointObservation& o,
                         const CameraMatrix& P,
                         const Eigen::Vector4d& X) {
  const Eigen::Vector3d y = P * X;
  return (y.head<2>() / y.z() - o.pixel) / o.sigma_px;
}

Eigen::Vector2d Residual(const LineObservation& o, const CameraMatrix& P, const LineSpan& X) {
  const Eigen::Vector3d l = (P * X.col(0)).cross(P * X.col(1));
  return Eigen::Vector2d(l.dot(o.start.homogeneous()), l.dot(o.end.homogeneous())) /
         (l.head<2>().norm() * o.sigma_px);
}

Linearized<kProjectiveCamera> Linearize(const PointObservation& o,
                                        const CameraMatrix& P,
                                        const Eigen::Vector4d& X) {
  const Eigen::Vector3d y = P * X;
  const Eigen::Vector2d u = y.head<2>() / y.z();
  const double s = 1.0 / (y.z() * o.sigma_px);
  const Eigen::RowVector4d sX = s * X.transpose();
  Linearized<kProjectiveCamera> out;
  out.r = (u - o.pixel) / o.sigma_px;
  out.J_camera.setZero();
  out.J_camera.block<1, 4>(0, 0) = sX;
  out.J_camera.block<1, 4>(1, 4) = sX;
  out.J_camera.block<1, 4>(0, 8) = -u.x() * sX;
  out.J_camera.block<1, 4>(1, 8) = -u.y() * sX;
  out.J_feature.row(0) = s * (P.row(0) - u.x() * P.row(2));
  out.J_feature.row(1) = s * (P.row(1) - u.y() * P.row(2));
  return out;
}

Linearized<kProjectiveCamera> Linearize(const LineObservation& o,
                                        const CameraMatrix& P,
                                        const LineSpan& X,
                                        const LineSpan& N) {
  const Eigen::Vector3d p = P * X.col(0), q = P * X.col(1);
  const Eigen::Matrix<double, 3, 2> PN = P * N;
  const Eigen::Vector3d l = p.cross(q);
  const double norm = l.head<2>().norm(), scale = 1.0 / o.sigma_px;
  const std::array<Eigen::Vector2d, 2> ends = {o.start, o.end};
  Linearized<kProjectiveCamera> out;
  for (int e = 0; e < 2; ++e) {
    const LineGradient g = DistanceGradient(p, q, l, norm, ends[e]);
    const Eigen::Vector3d dp = scale * g.by_p, dq = scale * g.by_q;
    out.r(e) = scale * g.distance;
    for (int r = 0; r < 3; ++r) {
      out.J_camera.block<1, 4>(e, 4 * r) = (dp(r) * X.col(0) + dq(r) * X.col(1)).transpose();
    }
    out.J_feature.block<1, 2>(e, 0) = dp.transpose() * PN;
    out.J_feature.block<1, 2>(e, 2) = dq.transpose() * PN;
  }
  return out;
}

CalibratedCamera MoveCamera(const CalibratedCamera& camera,
                            const Eigen::Matrix<double, kMetricCamera, 1>& step) {
  CalibratedCamera next = camera;
  const double angle = step.head<3>().norm();
  if (angle > 0.0) {
    const Eigen::AngleAxisd turn(angle, Eigen::Vector3d(step.head<3>() / angle));
    next.camera_from_scene.R = turn * camera.camera_from_scene.R;
  }
  next.camera_from_scene.t += step.segment<3>(3);
  next.camera.focal_px *= std::exp(step(kLogFocal));
  next.camera.cx += step(7);
  next.camera.cy += step(8);
  next.camera.k1 += step(kRadial);
  return next;
}

Eigen::Vector2d Residual(const PointObservation& o,
                         const CalibratedCamera& view,
                         const Eigen::Vector4d& X) {
  const Eigen::Vector3d c =
      view.camera_from_scene.R * X.head<3>() + view.camera_from_scene.t * X.w();
  return (Project(view.camera, c) - o.pixel) / o.sigma_px;
}

Eigen::Vector2d Residual(const LineObservation& o,
                         const CalibratedCamera& view,
                         const LineSpan& X) {
  const auto& [R, t] = view.camera_from_scene;
  const Eigen::Vector3d p = R * X.col(0).head<3>() + t * X(3, 0);
  const Eigen::Vector3d q = R * X.col(1).head<3>() + t * X(3, 1);
  const Eigen::Vector3d l = p.cross(q);
  return view.camera.focal_px / (l.head<2>().norm() * o.sigma_px) *
         Eigen::Vector2d(l.dot(Undistorted(view.camera, o.start).homogeneous()),
                         l.dot(Undistorted(view.camera, o.end).homogeneous()));
}

Linearized<kMetricCamera> Linearize(const PointObservation& o,
                                    const CalibratedCamera& view,
                                    const Eigen::Vector4d& X) {
  const auto& [R, t] = view.camera_from_scene;
  const PinholeCamera& camera = view.camera;
  const Eigen::Vector3d turned = R * X.head<3>();
  const Eigen::Vector3d c = turned + t * X.w();
  const Eigen::Vector2d x = c.head<2>() / c.z();
  const double scale = 1.0 / o.sigma_px;
  const Eigen::Vector2d distorted = (1.0 + camera.k1 * x.squaredNorm()) * x;
  Eigen::Matrix<double, 2, 3> x_by_c;  // times z
  x_by_c << 1.0, 0.0, -x.x(), 0.0, 1.0, -x.y();
  const Eigen::Matrix<double, 2, 3> J =
      (scale * camera.focal_px / c.z()) * DistortionJacobian(camera, x) * x_by_c;
  Linearized<kMetricCamera> out;
  out.r = scale * (camera.focal_px * distorted + Eigen::Vector2d(camera.cx, camera.cy) - o.pixel);
  for (int e = 0; e < 2; ++e) {  // c by w is -[turned]x
    out.J_camera.block<1, 3>(e, 0) = turned.cross(J.row(e).transpose()).transpose();
  }
  out.J_camera.middleCols<3>(3) = X.w() * J;
  out.J_camera.col(kLogFocal) = scale * camera.focal_px * distorted;
  out.J_camera.middleCols<2>(7) = scale * Eigen::Matrix2d::Identity();
  out.J_camera.col(kRadial) = scale * camera.focal_px * x.squaredNorm() * x;
  out.J_feature.leftCols<3>() = J * R;
  out.J_feature.col(3) = J * t;
  return out;
}

Linearized<kMetricCamera> Linearize(const LineObservation& o,
                                    const CalibratedCamera& view,
                                    const LineSpan& X,
                                    const LineSpan& N) {
  const auto& [R, t] = view.camera_from_scene;
  const PinholeCamera& camera = view.camera;
  const Eigen::Vector3d RA = R * X.col(0).head<3>(), RB = R * X.col(1).head<3>();
  const Eigen::Vector3d p = RA + t * X(3, 0), q = RB + t * X(3, 1);
  const Eigen::Matrix<double, 3, 2> PN = R * N.topRows<3>() + t * N.row(3);
  const Eigen::Vector3d l = p.cross(q);
  const double norm = l.head<2>().norm(), scale = camera.focal_px / o.sigma_px;
  const std::array<Eigen::Vector2d, 2> ends = {Undistorted(camera, o.start),
                                               Undistorted(camera, o.end)};
  Linearized<kMetricCamera> out;
  for (int e = 0; e < 2; ++e) {
    const Eigen::Vector2d& x = ends[e];
    const LineGradient g = DistanceGradient(p, q, l, norm, x);
    const Eigen::Vector3d dp = scale * g.by_p, dq = scale * g.by_q;
    out.r(e) = scale * g.distance;
    out.J_camera.block<1, 3>(e, 0) = (RA.cross(dp) + RB.cross(dq)).transpose();
    out.J_camera.block<1, 3>(e, 3) = (dp * X(3, 0) + dq * X(3, 1)).transpose();
    // x (1 + k1 |x|^2) = (pixel - c) / f: derivatives of x by the implicit function.
    const double r2 = x.squaredNorm();
    const Eigen::RowVector2d across =
        scale / norm * l.head<2>().transpose() * DistortionJacobian(camera, x).inverse();
    out.J_camera(e, kLogFocal) = out.r(e) - (1.0 + camera.k1 * r2) * across.dot(x);
    out.J_camera.block<1, 2>(e, 7) = -across / camera.focal_px;
    out.J_camera(e, kRadial) = -r2 * across.dot(x);
    out.J_feature.block<1, 2>(e, 0) = dp.transpose() * PN;
    out.J_feature.block<1, 2>(e, 2) = dq.transpose() * PN;
  }
  return out;
}

Eigen::Matrix<double, 6, 1> Residual(const PosePrior& prior, const Rigid3& camera_from_world) {
  const Eigen::AngleAxisd off(camera_from_world.R * prior.camera_from_world.R.transpose());
  Eigen::Matrix<double, 6, 1> r;
  r << off.angle() * off.axis() / prior.rotation_sigma_rad,
      (camera_from_world.Inverse().t - prior.camera_from_world.Inverse().t) /
          prior.position_sigma_m;
  return r;
}

Eigen::Matrix<double, 6, 6> Jacobian(const PosePrior& prior, const Rigid3& camera_from_world) {
  const auto& [R, t] = camera_from_world;
  const Eigen::AngleAxisd off(R * prior.camera_from_world.R.transpose());
  // log(exp(d) exp(w)) = w + J d + ..., J the inverse left Jacobian of SO(3).
  const Eigen::Matrix3d axis = CrossMatrix(off.axis());
  const double half = 0.5 * off.angle();
  const double along = half < 1e-8 ? 1.0 : half / std::tan(half);
  const Eigen::Matrix3d J = Eigen::Matrix3d::Identity() - half * axis + (1.0 - along) * axis * axis;
  Eigen::Matrix<double, 6, 6> out = Eigen::Matrix<double, 6, 6>::Zero();
  out.topLeftCorner<3, 3>() = J / prior.rotation_sigma_rad;
  out.bottomLeftCorner<3, 3>() = -(R.transpose() * CrossMatrix(t)) / prior.position_sigma_m;
  out.bottomRightCorner<3, 3>() = -R.transpose() / prior.position_sigma_m;
  return out;
}

}  // namespace horopter
