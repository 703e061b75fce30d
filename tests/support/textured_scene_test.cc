#include "tests/support/textured_scene.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

// The middle of what is bright, weighted.
Eigen::Vector2d BrightSpot(const cv::Mat& image) {
  cv::Mat grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  const cv::Moments m = cv::moments(cv::max(grey, 60) - 60);
  return {m.m10 / m.m00, m.m01 / m.m00};
}

// A dark plane with one bright disc, four millimetres wide, at a known place.
TexturedScene OneSpot(const Eigen::Vector2d& at_m) {
  TexturedSceneOptions options;
  options.boxes = 0;
  options.zoom = 1.5;
  TexturedScene scene = MakeTexturedScene(options);
  TexturedRectangle& floor = scene.bodies[0][0];
  floor.texel_m = 0.0005;
  floor.texture = cv::Mat(3200, 3200, CV_32F, cv::Scalar(40));
  const Eigen::Vector2d texel = (at_m - floor.corner.head<2>()) / floor.texel_m;
  cv::circle(floor.texture, cv::Point(cvRound(texel.x()), cvRound(texel.y())), 4, 250, -1);
  scene.background = 40;
  return scene;
}

TEST(RenderTextured, WhatIsAtAPlaceIsSeenWhereTheCameraProjectsIt) {
  const Eigen::Vector2d at(0.06, -0.03);
  TexturedScene scene = OneSpot(at);
  scene.views[1].camera.k1 = -0.2;
  for (int v = 0; v < 5; ++v) {
    const Eigen::Vector2d expected = Project(
        scene.views[v].camera, scene.CameraFromBody(v, 0) * Eigen::Vector3d(at.x(), at.y(), 0));
    EXPECT_LT((BrightSpot(RenderTextured(scene, v, 0.0)) - expected).norm(), 0.3);
  }
}

TEST(RenderTextured, ABodyMovesWithItsPoseAndAMirroredImageIsFlipped) {
  TexturedScene scene = OneSpot({0.0, 0.0});
  TexturedView& view = scene.views[2];
  view.world_from_body.resize(2);
  view.world_from_body[0].t = {0.05, 0.02, 0.0};
  const Eigen::Vector2d expected =
      Project(view.camera, scene.CameraFromBody(2, 0) * Eigen::Vector3d::Zero());
  EXPECT_LT((BrightSpot(RenderTextured(scene, 2, 0.0)) - expected).norm(), 0.3);
  view.mirrored = true;
  const Eigen::Vector2d flipped(view.camera.width - 1 - expected.x(), expected.y());
  EXPECT_LT((BrightSpot(RenderTextured(scene, 2, 0.0)) - flipped).norm(), 0.3);
}

TEST(RenderTextured, RowsOfARollingShutterAreTakenOneAfterTheOther) {
  TexturedScene scene = OneSpot({0.0, 0.0});
  const Eigen::Vector2d still = BrightSpot(RenderTextured(scene, 2, 0.0));
  scene.views[2].row_move_m = {0.05, 0.0, 0.0};
  const double share = still.y() / (scene.views[2].camera.height - 1) - 0.5;
  Rigid3 moved = scene.CameraFromBody(2, 0);
  moved.t.x() += share * 0.05;
  const Eigen::Vector2d expected = Project(scene.views[2].camera, moved * Eigen::Vector3d::Zero());
  EXPECT_LT((BrightSpot(RenderTextured(scene, 2, 0.0)) - expected).norm(), 0.5);
}

TEST(RenderTextured, AScreenChangesAndAMirrorShowsWhatIsBeforeIt) {
  const TexturedScene scene = WithScreenAndMirror(3, 2);
  TexturedScene dull = scene;
  dull.bodies[0][2].mirrors = false;
  dull.bodies[0][2].texture = cv::Mat(8, 8, CV_32F, cv::Scalar(150));
  EXPECT_GT(cv::norm(RenderTextured(scene, 0, 0.0), RenderTextured(dull, 0, 0.0), cv::NORM_INF),
            30);
  TexturedScene frozen = scene;
  frozen.views[1].camera_from_world = frozen.views[0].camera_from_world;
  EXPECT_GT(cv::norm(RenderTextured(frozen, 0, 0.0), RenderTextured(frozen, 1, 0.0), cv::NORM_INF),
            60);
}

TEST(RenderTextured, TexturesRepeatOrNot) {
  const cv::Mat alike = MarkerTexture(4, true, 5), apart = MarkerTexture(4, false, 5);
  const int pitch = alike.cols / 4;
  const auto differs = [pitch](const cv::Mat& t) {
    return cv::norm(
        t(cv::Rect(0, 0, pitch, pitch)), t(cv::Rect(pitch, 0, pitch, pitch)), cv::NORM_INF);
  };
  EXPECT_EQ(differs(alike), 0.0);
  EXPECT_GT(differs(apart), 100.0);
}

}  // namespace
}  // namespace horopter
