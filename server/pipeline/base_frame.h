// The robot's base frame from cameras whose poses in it the caller knows.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/vision/euclidean/euclidean.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// What the caller says of where a camera is. Deviations: of the rotation about each axis, and of
// each coordinate of the camera's centre.
struct CameraPoseHint {
  Rigid3 camera_from_base;
  double rotation_sigma_rad = 0.01;
  double position_sigma_m = 0.005;
};

struct BaseFrame {
  std::optional<Rigid3> base_from_scene;
  std::string conflict;  // which views contradict each other, in numbers; then there is no frame
};

// Every recovered camera with a hint says where the scene is; the weighted mean of what they say.
// Two that differ by more than kMaxHintDeviations of their joint deviations contradict each other.
// poses: one per camera or none.
inline constexpr double kMaxHintDeviations = 5.0;
BaseFrame BaseFromCameras(std::span<const std::optional<CameraPoseHint>> poses,
                          std::span<const std::optional<PosedCamera>> cameras);

}  // namespace horopter
