// Starts for focal lengths and poses from the homographies of one plane.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/geometry/rigid3.h"
#include "server/vision/reconstruction/reconstruction.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

// World: the plane is z = 0, the first view's centre is (0, 0, 1).
struct CalibrationStart {
  std::vector<double> focal_px;
  std::vector<Rigid3> camera_from_world;
  double cost = 0.0;
};

// Grid over the first view's focal length and the plane's normal; the other focal lengths follow
// from the orthogonality of the plane's axes. view_from_plane: plane coordinates are the first
// view's pixels, determinant 1 (w > 0 on the plane). priors: one per view; focal lengths that are
// given are taken as they are, principal points that are not are the images' centres. Best first,
// distinct, at most `keep`; empty when nothing is sane.
std::vector<CalibrationStart> CalibrateFromPlane(std::span<const Eigen::Matrix3d> view_from_plane,
                                                 std::span<const ImageSize> sizes,
                                                 std::span<const ViewPrior> priors,
                                                 const ReconstructionOptions& options,
                                                 int keep);

}  // namespace horopter
