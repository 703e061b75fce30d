// The second pass: everything matched once more under cameras that something else has told, such as
// a recognised part (frontend study: its geometry is right where matches alone give none).
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/matching/matching.h"

namespace horopter {

// A view whose camera and place are known.
struct PosedView {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
};

struct KnownCameras {
  std::span<const std::optional<PosedView>> views;  // one per image; empty: not known
  // A point about which the scene lies, scene frame: parallax is the angle of a pair's centres seen
  // from there.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
};

// Less parallax between two known views says nothing on where their epipolar lines run.
inline constexpr double kMinKnownParallaxRad = 0.01;

// Plane {x : normal . x = offset} of the scene frame in which the chained homographies of
// `matching` put what they map, least squares over the largest component; nullopt when fewer than
// two of its views are known, or when the cameras contradict it (more than 4 px rms).
struct SupportingPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit
  double offset = 0.0;
};
std::optional<SupportingPlane> PlaneUnderCameras(const KnownCameras& known,
                                                 const MatchingResult& matching);

// `first` with the pairs of two known views matched again along the epipolar lines of their cameras
// (MatchAlongEpipolarLines; lens distortion taken out of images and features before), with the
// supporting plane's homography where one is known, and all tracks joined anew. F of such a pair is
// that of undistorted pixels (same focal length and principal point). Pairs with an unknown view
// stay as they are; pairs of known views without parallax lose their F and say so. Errors:
// INVALID_ARGUMENT (sizes that do not agree, cameras that are not finite), CANCELLED.
absl::StatusOr<MatchingResult> MatchUnderCameras(std::span<const cv::Mat> images,
                                                 std::span<const ImageFeatures> features,
                                                 const KnownCameras& known,
                                                 const MatchingResult& first,
                                                 const MatchingOptions& options,
                                                 const StopRequested& stop = {});

}  // namespace horopter
