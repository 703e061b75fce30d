// The frame in which a reconstruction without a plane is given.
#pragma once

#include <Eigen/Core>

#include "server/vision/reconstruction/calibrated_scene.h"

namespace horopter {

// x_out = scale R (x_scene - centre).
struct SimilarityTransform {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double scale = 1.0;

  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return scale * (R * (x - centre)); }
};

// The points' middle is the origin, z points towards the cameras, whose mean distance is the unit.
SimilarityTransform FacingTheCameras(const CalibratedScene& scene);

// The same with the plane {x : normal . x = offset} as z = 0, its normal as z; the origin is the
// points' middle moved onto it.
SimilarityTransform OnPlane(const CalibratedScene& scene,
                            const Eigen::Vector3d& normal,
                            double offset);

// The view in that frame.
CalibratedView Moved(const CalibratedView& view, const SimilarityTransform& world_from_scene);

}  // namespace horopter
