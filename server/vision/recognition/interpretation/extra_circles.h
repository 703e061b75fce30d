// Round features on a placed part that images show and its CAD has not: another part of its kind
// has a hole there, or this one is printed on.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/interpretation/pose_odds.h"

namespace horopter {

struct ExtraCircle {
  Eigen::Vector3d place = Eigen::Vector3d::Zero();  // middle, object frame, metres
  double radius_m = 0.0;
  int views = 0;  // that show it in this place
};

// Ellipses of the contours that are circles on one of the part's faces, none of its edges, and in
// one place on it in two views or more; in most views first. hidden: see LogOddsBetween.
std::vector<ExtraCircle> FindExtraCircles(std::span<const AspectImage> images,
                                          const std::vector<std::optional<CalibratedCamera>>& views,
                                          const SeenPart& part,
                                          std::span<const DepthBuffer> hidden);

}  // namespace horopter
