#include "tests/diagnose/relative_cameras.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

namespace horopter {
namespace {

using Eigen::AngleAxisd;
using Eigen::Vector3d;

BopScene ThreeImages() {
  BopScene scene;
  for (int v = 0; v < 3; ++v) {
    BopImage image;
    image.camera = CenteredCamera(640, 480, 800.0);
    image.K = image.camera.K();
    image.has_pose = true;
    image.camera_from_world = {AngleAxisd(0.3 * v, Vector3d(0.1, 1.0, 0.2).normalized()).matrix(),
                               {0.1 * v, 0.05, 0.8 - 0.02 * v}};
    scene.images.push_back(image);
  }
  return scene;
}

// The true cameras in a world that is turned, moved and scaled.
std::vector<std::optional<EstimatedCamera>> Moved(const BopScene& scene) {
  std::vector<std::optional<EstimatedCamera>> views;
  const Rigid3 move = {AngleAxisd(1.0, Vector3d::UnitX()).matrix(), {1.0, 2.0, 3.0}};
  for (const BopImage& image : scene.images) {
    Rigid3 pose = image.camera_from_world * move;
    pose.t *= 7.0;
    views.push_back(EstimatedCamera{image.camera, pose, 0.01});
  }
  return views;
}

TEST(CompareRelative, ANewWorldChangesNothing) {
  const BopScene scene = ThreeImages();
  const CameraErrors errors = CompareRelative(Moved(scene), scene);
  EXPECT_EQ(errors.registered, 3);
  EXPECT_EQ(errors.rotations_deg.size(), 3u);
  EXPECT_LT(*errors.WorstRotation(), 1e-6);
  EXPECT_LT(*errors.MedianBaseline(), 1e-5);
  EXPECT_LT(*errors.WorstFocal(), 1e-12);
}

TEST(CompareRelative, MeasuresATurnAndAFocalLength) {
  const BopScene scene = ThreeImages();
  auto views = Moved(scene);
  views[2]->camera_from_world.R =
      AngleAxisd(0.1, Vector3d::UnitZ()).matrix() * views[2]->camera_from_world.R;
  views[0]->camera.focal_px *= 1.02;
  const CameraErrors errors = CompareRelative(views, scene);
  EXPECT_NEAR(*errors.WorstRotation(), 0.1 * 180.0 / M_PI, 1e-6);
  EXPECT_NEAR(*errors.MedianRotation(), 0.1 * 180.0 / M_PI, 1e-6);  // two pairs of three
  EXPECT_NEAR(*errors.WorstFocal(), 0.02, 1e-9);
  EXPECT_NEAR(errors.focal_in_sigmas[0], std::log(1.02) / 0.01, 1e-9);
}

TEST(CompareRelative, WhatIsNotKnownIsNoError) {
  BopScene scene = ThreeImages();
  auto views = Moved(scene);
  views[1].reset();
  scene.images[2].has_pose = false;
  views[0]->focal_log_sigma = 0.0;
  const CameraErrors errors = CompareRelative(views, scene);
  EXPECT_EQ(errors.registered, 2);
  EXPECT_FALSE(errors.MedianRotation());
  EXPECT_FALSE(errors.MedianBaseline());
  EXPECT_TRUE(errors.MedianFocal());
  EXPECT_EQ(errors.focal_in_sigmas.size(), 1u);
}

}  // namespace
}  // namespace horopter
