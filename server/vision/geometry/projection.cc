#include "server/vision/geometry/projection.h"

#include <Eigen/Dense>

namespace horopter {

LineCameraMatrix LineCamera(const CameraMatrix& P) {
  const Eigen::Vector4d p1 = P.row(0), p2 = P.row(1), p3 = P.row(2);
  LineCameraMatrix out;
  out.row(0) = JoinPoints(p2, p3).transpose();
  out.row(1) = JoinPoints(p3, p1).transpose();
  out.row(2) = JoinPoints(p1, p2).transpose();
  return out;
}

Eigen::Vector2d ProjectPoint(const CameraMatrix& P, const Eigen::Vector4d& point) {
  const Eigen::Vector3d x = P * point;
  return x.head<2>() / x.z();
}

Eigen::Vector3d ProjectLine(const CameraMatrix& P, const PluckerLine& line) {
  const Eigen::Vector3d l = LineCamera(P) * line;
  return l / l.head<2>().norm();
}

Eigen::Vector4d BackProjectLine(const CameraMatrix& P, const Eigen::Vector3d& line) {
  return P.transpose() * line;
}

Eigen::Vector4d CameraCenter(const CameraMatrix& P) {
  Eigen::Vector4d center;
  for (int k = 0; k < 4; ++k) {
    Eigen::Matrix3d minor;
    for (int c = 0, at = 0; c < 4; ++c) {
      if (c != k) minor.col(at++) = P.col(c);
    }
    center(k) = (k % 2 == 0 ? -1.0 : 1.0) * minor.determinant();
  }
  return center;
}

double SignedDepth(const CameraMatrix& P, const Eigen::Vector4d& point) {
  const double det = P.leftCols<3>().determinant();
  return (det < 0.0 ? -1.0 : 1.0) * P.row(2).dot(point) / point.w();
}

Eigen::Matrix4d CanonicalFrame(const CameraMatrix& P) {
  Eigen::Matrix4d full;
  full.topRows<3>() = P;
  full.row(3) = CameraCenter(P).normalized().transpose();
  return full.inverse();
}

}  // namespace horopter
