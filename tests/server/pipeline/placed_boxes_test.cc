// Boxes in the robot's base as parts of the images.
#include "server/pipeline/placed_boxes.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

namespace horopter {
namespace {

// Three cameras 0.6 m above the base's origin that look down; a box at the origin.
SceneRequest Request() {
  SceneRequest request;
  request.images.assign(3, cv::Mat(480, 640, CV_8UC1, cv::Scalar(9)));
  CameraHint hint;
  hint.focal_px = 600.0;
  hint.focal_log_sigma = 1e-4;
  request.hints.assign(3, hint);
  CameraPoseHint pose;
  pose.camera_from_base.R = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
  pose.camera_from_base.t = {0.0, 0.0, 0.6};
  pose.rotation_sigma_rad = 1e-5;
  pose.position_sigma_m = 1e-6;
  request.camera_poses.assign(3, pose);
  SpaceBox box;
  box.size_m = {0.1, 0.06, 0.01};
  request.space_boxes = {box};
  return request;
}

TEST(PlaceBoxes, IsWhereTheCamerasSeeThem) {
  SceneRequest request = Request();
  ASSERT_TRUE(PlaceBoxes(&request).ok());
  ASSERT_EQ(request.searched.size(), 3u);
  for (const auto& part : request.searched) {
    ASSERT_TRUE(part);
    ASSERT_EQ(part->boxes.size(), 1u);
    EXPECT_NEAR(part->boxes[0].center().x(), 319.5, 0.5);
    EXPECT_NEAR(part->boxes[0].sizes().x(), 100.0, 2.0);
    EXPECT_NEAR(part->boxes[0].sizes().y(), 60.0, 2.0);
  }
}

TEST(PlaceBoxes, NothingChangesWithoutAny) {
  SceneRequest request = Request();
  request.space_boxes.clear();
  ASSERT_TRUE(PlaceBoxes(&request).ok());
  EXPECT_TRUE(request.searched.empty());
}

TEST(PlaceBoxes, JoinTheImagesOwnRegions) {
  SceneRequest request = Request();
  request.searched.resize(3);
  const ImageBox own(Eigen::Vector2d(5, 5), Eigen::Vector2d(50, 50));
  request.searched[1] = SearchedPart{{own}, {}, 1.0};
  ASSERT_TRUE(PlaceBoxes(&request).ok());
  ASSERT_EQ(request.searched[1]->boxes.size(), 2u);
  EXPECT_TRUE(request.searched[1]->boxes[0].isApprox(own));
}

TEST(PlaceBoxes, AnImageThatShowsNoneIsNotSearchedAndOneOfAnUnknownCameraWhole) {
  SceneRequest request = Request();
  request.camera_poses[0]->camera_from_base.t.x() = 3.0;  // beside
  request.hints[1].focal_px.reset();
  ASSERT_TRUE(PlaceBoxes(&request).ok());
  ASSERT_TRUE(request.searched[0]);
  EXPECT_TRUE(request.searched[0]->boxes.empty());
  EXPECT_FALSE(request.searched[1]);
  EXPECT_EQ(request.searched[2]->boxes.size(), 1u);
}

TEST(PlaceBoxes, NeedAKnownCameraThatShowsThem) {
  SceneRequest unknown = Request();
  unknown.camera_poses.clear();
  EXPECT_TRUE(absl::IsFailedPrecondition(PlaceBoxes(&unknown)));
  SceneRequest unhinted = Request();
  unhinted.hints.clear();
  EXPECT_TRUE(absl::IsFailedPrecondition(PlaceBoxes(&unhinted)));
  SceneRequest behind = Request();
  behind.space_boxes[0].base_from_box.t.z() = 2.0;
  EXPECT_TRUE(absl::IsInvalidArgument(PlaceBoxes(&behind)));
}

// Two fixed cameras of a station, of which one has been tied to the base: the other is through it.
TEST(PlaceBoxes, TakesCamerasOfTheStation) {
  SceneRequest request = Request();
  request.images.resize(2);
  request.hints.clear();
  request.camera_poses.clear();
  StationRequest& station = request.station.emplace();
  station.views = {0, 1};
  for (int c = 0; c < 2; ++c) {
    AddStationCamera("camera", 640, 480, {}, &station.state);
    StationCamera& camera = station.state.cameras.back();
    camera.camera = CenteredCamera(640, 480, 600.0);
    camera.posed = true;
    camera.camera_from_rig.t = {c * 0.1, 0.0, 0.6};
    camera.requests = 5;
  }
  station.state.covariance *= 1e-6;
  CameraBase base;
  base.base_from_camera.R = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
  base.base_from_camera.t = {0.0, 0.0, 0.6};
  station.bases = {base, std::nullopt};
  ASSERT_TRUE(PlaceBoxes(&request).ok());
  ASSERT_TRUE(request.searched[0] && request.searched[1]);
  EXPECT_NEAR(request.searched[0]->boxes[0].center().x(), 319.5, 2.0);
  EXPECT_NEAR(request.searched[1]->boxes[0].center().x(), 419.5, 6.0);
}

}  // namespace
}  // namespace horopter
