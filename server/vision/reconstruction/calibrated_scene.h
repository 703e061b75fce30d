// Cameras, points and lines up to a similarity, and what is known about the cameras beforehand.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// What a request says about one camera; each with the deviation it is believed to. Nothing set:
// only the weak priors of SelfCalibrationOptions hold.
struct ViewPrior {
  std::optional<double> focal_px;
  double focal_log_sigma = 0.02;
  std::optional<Eigen::Vector2d> principal_point_px;
  double principal_point_sigma_px = 2.0;
  std::optional<double> k1;
  double k1_sigma = 0.01;
  std::optional<Rigid3> camera_from_world;  // two or more fix the world's scale and place
  double rotation_sigma_rad = 0.01;
  double position_sigma_m = 0.005;  // of the camera's centre
};

struct CalibratedView {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
  double focal_log_sigma = 0.0;  // posterior, with the principal point's uncertainty in it
};

struct CalibratedScene {
  std::vector<std::optional<CalibratedView>> views;
  std::vector<std::optional<Eigen::Vector3d>> points;  // in the scene frame; its scale is arbitrary
  std::vector<std::optional<PluckerLine>> lines;       // unless poses were given
};

}  // namespace horopter
