// Cameras, points and lines up to a similarity.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

struct CalibratedView : CalibratedCamera {
  double focal_log_sigma = 0.0;  // posterior, with the principal point's uncertainty in it
};

struct CalibratedScene {
  std::vector<std::optional<CalibratedView>> views;
  std::vector<std::optional<Eigen::Vector3d>> points;  // in the scene frame; its scale is arbitrary
  std::vector<std::optional<PluckerLine>> lines;       // unless poses were given
};

}  // namespace horopter
