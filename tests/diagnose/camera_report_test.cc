#include "tests/diagnose/camera_report.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "server/pipeline/pipeline.h"
#include "tests/diagnose/object_report.h"
#include "tests/diagnose/reduced_images.h"

namespace horopter {
namespace {

// Four cameras on an arc around a random part of 12 vertices.
struct World {
  BopScene scene;
  TrueModels models;
};

World MakeWorld(unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u(-0.05, 0.05);
  World world;
  ObjectModel& model = world.models[7];
  model.id = BopObjectName(7);
  for (int k = 0; k < 12; ++k) {
    model.vertices.emplace_back(u(rng), u(rng), u(rng));
  }
  model.mesh.vertices = model.vertices;
  for (int v = 0; v < 4; ++v) {
    BopImage image;
    image.camera = CenteredCamera(640, 480, 900.0 + 40.0 * v);
    image.has_pose = true;
    image.camera_from_world.R = (Eigen::AngleAxisd(0.9, Eigen::Vector3d::UnitX()) *
                                 Eigen::AngleAxisd(0.25 * v, Eigen::Vector3d::UnitZ()))
                                    .toRotationMatrix();
    image.camera_from_world.t = {0.01 * v, -0.01, 0.6};
    image.instances.push_back(
        {7, image.camera_from_world, 1.0});  // the part's frame is the world's
    world.scene.images.push_back(image);
  }
  return world;
}

// The true cameras in a world turned, moved and scaled.
std::vector<std::optional<EstimatedView>> MovedCameras(const World& world, double scale) {
  std::vector<std::optional<EstimatedView>> views;
  const Rigid3 move = {
      Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix(),
      {0.4, -2.0, 1.0}};
  for (const BopImage& image : world.scene.images) {
    Rigid3 pose = image.camera_from_world * move.Inverse();
    pose.t *= scale;
    views.push_back(EstimatedView{image.camera, pose});
  }
  return views;
}

TEST(CompareCameras, CamerasInAnotherGaugeAreRecovered) {
  const World world = MakeWorld(1);
  const auto corners = TrueWorldCorners(world.scene, world.models);
  ASSERT_EQ(corners.size(), 12u);
  const auto views = MovedCameras(world, 3.7);
  for (Freedom freedom : {Freedom::kSimilarity, Freedom::kCollineation}) {
    const CameraFinding finding = CompareCameras(views, world.scene, corners, freedom);
    EXPECT_TRUE(finding.recovered);
    EXPECT_LT(finding.worst_view_px, 1e-2);
  }
  EXPECT_NEAR(*FocalError(views, world.scene), 0.0, 1e-12);
}

TEST(CompareCameras, WrongOrMissingCamerasAreNot) {
  const World world = MakeWorld(2);
  const auto corners = TrueWorldCorners(world.scene, world.models);
  auto views = MovedCameras(world, 1.0);
  views[2]->camera_from_world.R =
      Eigen::AngleAxisd(0.03, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
      views[2]->camera_from_world.R;
  const CameraFinding turned = CompareCameras(views, world.scene, corners, Freedom::kSimilarity);
  EXPECT_TRUE(turned.aligned);
  EXPECT_FALSE(turned.recovered);
  views = MovedCameras(world, 1.0);
  views[1].reset();
  const CameraFinding missing = CompareCameras(views, world.scene, corners, Freedom::kSimilarity);
  EXPECT_EQ(missing.registered, 3);
  EXPECT_FALSE(missing.recovered);
  EXPECT_LT(missing.worst_view_px, 1e-2);
  views.assign(4, std::nullopt);
  EXPECT_FALSE(CompareCameras(views, world.scene, corners, Freedom::kCollineation).aligned);
  EXPECT_FALSE(FocalError(views, world.scene).has_value());
}

TEST(FollowObjects, TheTruthIsFinalAndAWrongPoseIsLostAtVerification) {
  const World world = MakeWorld(3);
  PipelineResult result;
  for (const BopImage& image : world.scene.images) {
    result.trace.recognition.views.push_back(
        CalibratedCamera{image.camera, image.camera_from_world});
    PosedCamera posed;
    posed.camera = image.camera;
    posed.camera_from_scene = image.camera_from_world;
    result.answer.cameras.push_back(posed);
  }
  AnswerObject answer;
  answer.object_id = BopObjectName(7);
  result.answer.objects.push_back(answer);
  const std::vector<std::string> ids = {BopObjectName(7)};
  const std::vector<TrueView> truth(4);
  const std::vector<FeatureFinding> findings(4);
  std::vector<ObjectFate> fates =
      FollowObjects(result, ids, world.scene, world.models, truth, findings);
  ASSERT_EQ(fates.size(), 1u);
  EXPECT_TRUE(fates[0].final && fates[0].verified && fates[0].hypothesised);
  EXPECT_EQ(fates[0].lost_at, "none");
  EXPECT_NEAR(*fates[0].final_px, 0.0, 1e-9);

  result.answer.objects[0].scene_from_object.t = {0.02, 0.0, 0.0};  // about 30 px
  ViewHypothesis hypothesis;
  hypothesis.object = 0;
  hypothesis.view = 1;
  hypothesis.camera = world.scene.images[1].camera;
  hypothesis.camera_from_object = world.scene.images[1].camera_from_world;
  result.trace.recognition.hypotheses.push_back(hypothesis);
  fates = FollowObjects(result, ids, world.scene, world.models, truth, findings);
  EXPECT_TRUE(fates[0].hypothesised);
  EXPECT_FALSE(fates[0].verified || fates[0].final);
  EXPECT_EQ(fates[0].lost_at, "verification");

  result.trace.recognition.hypotheses.clear();
  fates = FollowObjects(result, ids, world.scene, world.models, truth, findings);
  EXPECT_EQ(fates[0].lost_at, "features");  // no edge of it was found either
}

TEST(ProjectionError, HonoursSymmetriesAndImageWidth) {
  World world = MakeWorld(4);
  ObjectModel model;
  model.mesh.vertices = {{0.03, 0, 0}, {-0.03, 0, 0}, {0, 0.03, 0}, {0, -0.03, 0}};
  Rigid3 half_turn;
  half_turn.R.diagonal() << -1, -1, 1;
  BopImage image = world.scene.images[0];
  const Rigid3 pose = image.camera_from_world;
  EXPECT_GT(ProjectionError(model, image.camera, pose * half_turn, image, pose), 20.0);
  model.symmetries.push_back(half_turn);
  EXPECT_NEAR(ProjectionError(model, image.camera, pose * half_turn, image, pose), 0.0, 1e-9);
  Rigid3 off = pose;
  off.t.x() += 0.001;
  const double at_640 = ProjectionError(model, image.camera, off, image, pose);
  image.camera.width = 1280;
  EXPECT_NEAR(ProjectionError(model, image.camera, off, image, pose), 0.5 * at_640, 1e-9);
}

TEST(ReducedImages, HaveThePipelinesSizes) {
  EXPECT_EQ(kLeastSidePx, PipelineOptions().least_side_px);
  EXPECT_EQ(kSmallSidePx, PipelineOptions().small_side_px);
}

}  // namespace
}  // namespace horopter
