// What is known about a camera before its images are looked at.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>

#include "absl/status/status.h"
#include "server/vision/geometry/camera_prior.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// What a request says about one camera; each with the deviation it is believed to. Nothing set:
// only the weak priors of the options hold.
struct ViewPrior {
  std::optional<double> focal_px;
  double focal_log_sigma = kHintedFocalLogSigma;
  std::optional<Eigen::Vector2d> principal_point_px;
  double principal_point_sigma_px = 2.0;
  std::optional<double> k1;
  double k1_sigma = 0.01;
  std::optional<Rigid3> camera_from_world;  // two or more fix the world's scale and place
  double rotation_sigma_rad = 0.01;
  double position_sigma_m = 0.005;  // of the camera's centre
};

// priors: one per view or none. Errors: INVALID_ARGUMENT naming the view that has something not
// finite, a focal length or a deviation that is not positive, or a matrix that is no proper
// rotation.
absl::Status Validate(std::span<const ViewPrior> priors, std::size_t views);

}  // namespace horopter
