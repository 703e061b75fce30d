// Cameras that are known before any part is: of a station or of a reconstruction from texture.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <optional>
#include <vector>

#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// A prior with deviations, never the truth. The cameras know nothing of the parts: a part that one
// image shows and the others confirm is there.
struct KnownCameras {
  // One per image, empty: not known. Their scene frame is in metres where scale_known, else in any
  // unit. No views: nothing is known.
  std::vector<std::optional<CalibratedView>> views;
  bool scale_known = false;
  double rotation_sigma_rad = 0.0;
  // Of a camera's centre, as a share of its distance from what it sees.
  double position_sigma = 0.0;
  std::vector<ReconstructedPoint> points;  // world: the scene frame; may be empty

  int known() const {
    return static_cast<int>(
        std::count_if(views.begin(), views.end(), [](const auto& v) { return v.has_value(); }));
  }
};

// Those of a reconstruction that is to be trusted, in its unit; else no views.
KnownCameras CamerasOfReconstruction(const Reconstruction& reconstruction);

}  // namespace horopter
