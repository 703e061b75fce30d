// A projective camera taken apart: calibration, rotation, translation.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "server/vision/geometry/projection.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// P ~ K [R | t].
struct CameraFactors {
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();  // upper triangular, positive, K(2, 2) = 1
  Rigid3 camera_from_scene;                         // in the units of P's frame
};

// By the QR decomposition of the reversed transpose (Hartley, Zisserman 2004, A4.1). The sign of P
// is the one for which R is a rotation. Empty when P is not finite or its left 3 x 3 is singular.
std::optional<CameraFactors> FactorCamera(const CameraMatrix& P);

}  // namespace horopter
