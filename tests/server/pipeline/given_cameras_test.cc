#include "server/pipeline/given_cameras.h"

#include <gtest/gtest.h>

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
  out.points.emplace_back().point_in_world = {0.1, 0.2, 0.3};
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
  ASSERT_EQ(known.points.size(), 1u);
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

SceneRequest Posed() {
  SceneRequest request;
  for (int v = 0; v < 3; ++v) {
    request.images.push_back(cv::Mat(480, 640, CV_8UC3));
    CameraHint hint;
    hint.focal_px = 700.0 + v;
    request.hints.push_back(hint);
    CameraPoseHint pose;
    pose.camera_from_base.t = {-0.2 * v, 0.0, 0.6};
    request.camera_poses.push_back(pose);
  }
  request.hints[1].principal_point = Eigen::Vector2d(310.0, 250.0);
  return request;
}

TEST(GivenCameras, OfARequestAreItsPlacesAndLensesInMetres) {
  const KnownCameras known = CamerasOfRequest(Posed());
  ASSERT_EQ(known.known(), 3);
  EXPECT_TRUE(known.scale_known);
  EXPECT_EQ(known.views[2]->camera.focal_px, 702.0);
  EXPECT_EQ(known.views[0]->camera.cx, 319.5);
  EXPECT_EQ(known.views[1]->camera.cx, 310.0);
  EXPECT_EQ(known.views[1]->camera.cy, 250.0);
  EXPECT_EQ(known.views[2]->camera_from_scene.t, Eigen::Vector3d(-0.4, 0.0, 0.6));
  EXPECT_NEAR(known.position_sigma, CameraPoseHint().position_sigma_m / 0.4, 1e-12);
}

TEST(GivenCameras, OfARequestThatLeavesOneOpenOrLooseAreNone) {
  const auto none = [](const char* what, const auto& change) {
    SceneRequest request = Posed();
    change(&request);
    EXPECT_TRUE(CamerasOfRequest(request).views.empty()) << what;
  };
  none("no places", [](SceneRequest* r) { r->camera_poses.clear(); });
  none("no lenses", [](SceneRequest* r) { r->hints.clear(); });
  none("a place is missing", [](SceneRequest* r) { r->camera_poses[1].reset(); });
  none("a focal length is missing", [](SceneRequest* r) { r->hints[2].focal_px.reset(); });
  none("a loose lens", [](SceneRequest* r) { r->hints[0].focal_log_sigma = 0.1; });
  none("a loose place", [](SceneRequest* r) { r->camera_poses[0]->position_sigma_m = 0.05; });
  none("a loose turn", [](SceneRequest* r) { r->camera_poses[0]->rotation_sigma_rad = 0.05; });
  none("one place for all", [](SceneRequest* r) {
    for (auto& pose : r->camera_poses) pose->camera_from_base.t = {0.0, 0.0, 0.6};
  });
}

}  // namespace
}  // namespace horopter
