#include "server/pipeline/given_cameras.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

namespace horopter {
namespace {

// Cameras half a metre apart from each other, the last one unknown.
Reconstruction Reconstructed() {
  Reconstruction out;
  out.trusted = true;
  for (int v = 0; v < 3; ++v) {
    CalibratedView view;
    view.camera = CenteredCamera(640, 480, 700.0 + v);
    view.camera_from_scene.t = {-0.5 * v, 0.0, 2.0};
    view.focal_log_sigma = 0.03;
    out.views.emplace_back(view);
  }
  out.views.emplace_back();
  out.points.push_back({{0.1, 0.2, 0.3}, {}, false});
  return out;
}

TEST(GivenCameras, OfATrustedReconstructionAreItsOwnUpToScale) {
  const KnownCameras known = CamerasOfReconstruction(Reconstructed());
  ASSERT_EQ(known.views.size(), 4u);
  EXPECT_EQ(known.known(), 3);
  EXPECT_FALSE(known.scale_known);
  EXPECT_GT(known.rotation_sigma_rad, 0.0);
  EXPECT_GT(known.position_sigma, 0.0);
  EXPECT_EQ(known.views[1]->camera.focal_px, 701.0);
  EXPECT_EQ(known.views[1]->focal_log_sigma, 0.03);
  ASSERT_EQ(known.points_in_world.size(), 1u);
}

TEST(GivenCameras, OfAReconstructionThatIsNotTrustedOrHasOneViewAreNone) {
  Reconstruction untrusted = Reconstructed();
  untrusted.trusted = false;
  EXPECT_TRUE(CamerasOfReconstruction(untrusted).views.empty());
  Reconstruction one = Reconstructed();
  one.views[1].reset();
  one.views[2].reset();
  EXPECT_TRUE(CamerasOfReconstruction(one).views.empty());
}

// Images with poses half a metre apart and focal lengths.
SceneRequest Posed(std::vector<cv::Mat>* images) {
  images->assign(3, cv::Mat(480, 640, CV_8UC1, cv::Scalar(0)));
  SceneRequest request;
  request.images = *images;
  for (int v = 0; v < 3; ++v) {
    CameraHint hint;
    hint.focal_px = 700.0;
    request.hints.push_back(hint);
    CameraPoseHint pose;
    pose.camera_from_base.t = {-0.5 * v, 0.0, 1.0};
    pose.rotation_sigma_rad = 0.005;
    pose.position_sigma_m = 0.002;
    request.camera_poses.emplace_back(pose);
  }
  return request;
}

TEST(GivenCameras, OfARequestAreInMetres) {
  std::vector<cv::Mat> images;
  const KnownCameras known = CamerasOfRequest(Posed(&images));
  EXPECT_EQ(known.known(), 3);
  EXPECT_TRUE(known.scale_known);
  EXPECT_EQ(known.rotation_sigma_rad, 0.005);
  EXPECT_NEAR(known.position_sigma, 0.002, 1e-9);  // the farthest are a metre apart
}

TEST(GivenCameras, OfARequestWithoutLensesOrPlacesAreNone) {
  std::vector<cv::Mat> images;
  SceneRequest request = Posed(&images);
  request.hints.clear();
  EXPECT_TRUE(CamerasOfRequest(request).views.empty());
  request = Posed(&images);
  request.camera_poses.clear();
  EXPECT_TRUE(CamerasOfRequest(request).views.empty());
  request = Posed(&images);
  for (CameraHint& hint : request.hints) hint.presumed = true;
  EXPECT_TRUE(CamerasOfRequest(request).views.empty());
  request = Posed(&images);
  for (auto& pose : request.camera_poses) pose->rotation_sigma_rad = 0.2;
  EXPECT_TRUE(CamerasOfRequest(request).views.empty());
  request = Posed(&images);
  for (auto& pose : request.camera_poses) pose->camera_from_base.t = {0, 0, 1};
  EXPECT_TRUE(CamerasOfRequest(request).views.empty());  // one place says nothing
}

}  // namespace
}  // namespace horopter
