// Epipolar geometry from a known plane homography and the parallax of points off the plane: F =
// [e]x H.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/matching/matching_options.h"

namespace horopter {

// A possible match of junction index_a with index_b; similarity in [-1, 1].
struct MatchCandidate {
  int index_a = -1;
  int index_b = -1;
  Eigen::Vector2d a = Eigen::Vector2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
  double similarity = 0.0;
  double parallax_px = 0.0;  // |H^-1 b - a|
};

struct ParallaxResult {
  std::optional<Eigen::Matrix3d> F;  // unit Frobenius norm
  Eigen::Vector3d epipole_b = Eigen::Vector3d::Zero();
  std::vector<MatchCandidate> matches;  // off-plane inliers, then on-plane matches; one-to-one
  int off_plane = 0;
  std::string refusal;  // why F is empty
};

// b_from_a: homography of the plane. All points off the plane lie on one side of it (towards the
// cameras), so their parallax has one sign; the sign is found too. Identical views and pure
// rotation give a refusal: no parallax.
ParallaxResult EstimatePlaneParallax(const Eigen::Matrix3d& b_from_a,
                                     std::span<const MatchCandidate> candidates,
                                     const ParallaxOptions& options);

}  // namespace horopter
