// Starts of the self-calibration: planes at infinity from the focal lengths of two views.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/collineation.h"
#include "server/vision/reconstruction/self_calibration.h"

namespace horopter {

// v of H = [K_a 0; v^T 1] with P_a = K_a [I | 0] H^-1 and P_b H ~ K_b [R | t]: closed form of
// Gherardi, Fusiello (2010). P_b in the frame where P_a = [I | 0]. Nullopt without a baseline.
std::optional<Eigen::Vector3d> PlaneAtInfinity(const CameraMatrix& P_b,
                                               const Eigen::Matrix3d& K_a,
                                               const Eigen::Matrix3d& K_b);

// Grid over the focal lengths of pairs of views; every plane at infinity is judged by the cameras
// it gives all views (aspect, skew, principal point, priors). The best distinct ones as metric
// scenes of scale 1 (rms distance of points from their centroid), cheapest first, at most
// options.max_starts.
std::vector<CalibratedScene> FindCalibrationStarts(const MultiviewTracks& tracks,
                                                   const ProjectiveScene& scene,
                                                   std::span<const ViewPrior> priors,
                                                   const SelfCalibrationOptions& options);

}  // namespace horopter
