// Quasi-affine frames: which side of every camera the scene is on (thesis 3.5; Hartley 1998).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

struct QuasiAffineFrame {
  // scene' = H scene: no point and no segment between two points crosses the plane at infinity, and
  // every consistent camera has what it sees in front of it.
  Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
  // Smallest slack of the chiral inequalities over unit vectors; small: the plane at infinity
  // nearly touches the scene or a camera.
  double margin = 0.0;
  // Views that see the scene on the same side as the majority; false for a mirrored image.
  std::vector<bool> camera_consistent;
  std::vector<bool> point_consistent;
};

// From the inlier observations. Signs are propagated so that all depths P_3 X are positive; points
// that contradict the majority of their views are inconsistent. Then v with X_j . v > 0 and
// delta C_i . v > 0 is found for delta = +-1 (C_i the signed centres), of largest slack. Views are
// left out, one by one, where nothing satisfies all. Nullopt when no plane at infinity avoids the
// scene or fewer than two cameras remain.
std::optional<QuasiAffineFrame> FindQuasiAffineFrame(const MultiviewTracks& tracks,
                                                     const ProjectiveScene& scene);

// scene mapped by H; lines and planes too.
ProjectiveScene MapScene(const Eigen::Matrix4d& H, const ProjectiveScene& scene);

}  // namespace horopter
