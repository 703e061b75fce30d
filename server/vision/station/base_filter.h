// Where references say that a station's cameras are in the robot's base: tested against what is
// known, and joined to it (an information filter, as for the cameras themselves, ADR 30). All
// functions are pure.
#pragma once

#include "server/vision/geometry/camera_base.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/station/station_filter.h"

namespace horopter {

// base_from_camera by a request's references, its deviations the root mean squares of the
// covariance's, taken for `widening` times less sure than they say.
CameraBase BaseSeen(const UncertainPose& base_from_camera, const StationOptions& options);

struct BaseTest {
  bool agrees = true;
  double turn_rad = 0.0;  // how far apart the two are
  double shift_m = 0.0;
  double squared = 0.0;  // Mahalanobis distance, and what it must not exceed
  double limit = 0.0;
};

// Whether the two say the same of one camera. They differ when the distance is beyond
// alarm_sigmas, and the turn beyond kLeastBaseTurnRad or the shift beyond kLeastBaseShiftM.
inline constexpr double kLeastBaseTurnRad = 0.0087;
inline constexpr double kLeastBaseShiftM = 0.002;
BaseTest TestBase(const CameraBase& known, const CameraBase& seen, const StationOptions& options);

// Where a fixed camera is in the base by that of another and their places in the rig.
CameraBase ThroughRig(const StationState& state, const CameraBase& known, int from, int to);

// What is known after a request that agrees: the surer of the two counts more. What people said
// stays.
CameraBase UpdateBase(const CameraBase& known,
                      const CameraBase& seen,
                      const StationOptions& options);

}  // namespace horopter
