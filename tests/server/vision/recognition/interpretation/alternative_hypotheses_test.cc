#include "server/vision/recognition/interpretation/alternative_hypotheses.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>

#include "server/vision/recognition/interpretation/answer.h"
#include "server/vision/recognition/interpretation/decision.h"
#include "tests/support/one_object_views.h"
#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

ObjectModel Box(double x, double y, double z) {
  return Prism("box", {{0, 0}, {x, 0}, {x, y}, {0, y}}, z);
}

Rigid3 Turn(const PreparedObject& object, double angle, const Eigen::Vector3d& axis) {
  const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
  return {R, object.center - R * object.center};
}

// A ball's turns are all alike, but its edges, which it has none of, do not say so.
TEST(NearSymmetries, AreNoneOfAPartWithoutEdges) {
  ObjectModel ball;
  ball.id = "ball";
  ball.mesh = SphereMesh(0.02, 16);
  ball.diameter_m = 0.04;
  const auto prepared = PrepareObject(ball).value();
  ASSERT_TRUE(prepared->samples.empty());
  EXPECT_TRUE(NearSymmetries(*prepared, 0.06).empty());
}

TEST(NearSymmetries, AreTheTurnsOfAnAlmostSquareBox) {
  const auto box = PrepareObject(Box(0.1, 0.104, 0.06)).value();
  const std::vector<Rigid3> turns = NearSymmetries(*box, 0.06);
  const auto has = [&](const Rigid3& turn) {
    return std::any_of(
        turns.begin(), turns.end(), [&](const Rigid3& t) { return (t.R - turn.R).norm() < 1e-9; });
  };
  EXPECT_TRUE(has(Turn(*box, std::numbers::pi / 2, Eigen::Vector3d::UnitZ())));
  EXPECT_TRUE(has(Turn(*box, std::numbers::pi, Eigen::Vector3d::UnitX())));
  EXPECT_FALSE(has(Turn(*box, std::numbers::pi / 2, Eigen::Vector3d::UnitX())));
  EXPECT_FALSE(has(Rigid3{}));
}

TEST(NearSymmetries, LeaveOutWhatIsASymmetryOrNoneAtAll) {
  ObjectModel model = Box(0.1, 0.05, 0.02);
  const auto plain = PrepareObject(model).value();
  for (const Eigen::Vector3d& axis :
       {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0), Eigen::Vector3d(0, 0, 1)}) {
    model.symmetries.push_back(Turn(*plain, std::numbers::pi, axis));
  }
  EXPECT_EQ(NearSymmetries(*plain, 0.06).size(), 3u);
  EXPECT_TRUE(NearSymmetries(*PrepareObject(model).value(), 0.06).empty());
}

TEST(ContestObjects, TurnsABoxThatStandsTheWrongWayRound) {
  for (const double noise_px : {0.0, 0.4}) {
    OneObjectViews views(Box(0.1, 0.112, 0.06), 4, 0.4, noise_px);
    const PreparedObject& box = *views.objects[0];
    views.Place(Turn(box, std::numbers::pi / 2, Eigen::Vector3d::UnitZ()));
    const double wrong = views.scene.objects[0].score;
    const std::vector<Alternative> alternatives =
        ContestObjects(views.context, nullptr, {}, &views.scene);
    EXPECT_FALSE(alternatives.empty());
    EXPECT_GT(views.scene.objects[0].score, wrong);
    // Right up to the half turn, which is a symmetry that nobody declared.
    EXPECT_GT(std::abs(views.scene.objects[0].scene_from_object.R(0, 0)), 0.98);
    for (const Alternative& r : alternatives) EXPECT_EQ(r.accepted, 0);
  }
}

TEST(MakeResult, SaysWhenAnotherPoseOfTheObjectScoresAsWell) {
  OneObjectViews views(Box(0.1, 0.104, 0.06), 4, 0.4, 0.0);
  views.Place({});
  Alternative alternative{0, views.scene.objects[0], views.scene.objects[0].score - 0.08, 0.0};
  const auto state = [&](bool trusted) {
    return MakeResult(views.context,
                      views.scene,
                      {},
                      BestCompeting(views.context, views.scene, {}, {&alternative, 1}),
                      {&alternative, 1},
                      trusted);
  };
  EXPECT_EQ(state(true).state, RecognitionState::kRecognized);
  const RecognitionResult loose = state(false);  // the cameras may have adapted to either pose
  EXPECT_EQ(loose.state, RecognitionState::kAmbiguous);
  ASSERT_EQ(loose.objects.size(), 1u);
  EXPECT_EQ(loose.objects[0].alternatives, std::vector<int>{0});
  EXPECT_FALSE(loose.detail.empty());
  alternative.score = views.scene.objects[0].score - 0.01;
  EXPECT_EQ(state(true).state, RecognitionState::kAmbiguous);
  alternative.score = 0.0;
  EXPECT_EQ(state(false).state, RecognitionState::kRecognized);
}

TEST(MakeResult, AnswersNothingWithoutParallax) {
  for (const double step : {0.001, 0.004, 0.05, 0.3}) {
    OneObjectViews views(LBracket(), 4, step, 0.0);
    views.Place({});
    const double parallax = LargestParallax(views.context, views.scene);
    EXPECT_GT(parallax, step);  // 3 steps about a point below the cameras
    EXPECT_LT(parallax, 3.0 * step + 1e-6);
    const RecognitionResult r = MakeResult(
        views.context, views.scene, {}, BestCompeting(views.context, views.scene, {}), {}, true);
    if (3 * step < 0.035) {
      EXPECT_EQ(r.state, RecognitionState::kNoParallax);
      EXPECT_TRUE(r.objects.empty());
      EXPECT_FALSE(r.detail.empty());
    } else {
      EXPECT_EQ(r.state, RecognitionState::kRecognized);
      EXPECT_EQ(r.objects.size(), 1u);
    }
  }
}

TEST(EvaluateTogether, WhatOneObjectHidesIsNoEvidenceAgainstAnother) {
  OneObjectViews views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  const PlacedObject alone = views.scene.objects[0];
  PlacedObject before = alone;  // halfway to the middle camera
  before.scene_from_object.t += 0.5 * views.scene.views[1]->camera_from_scene.Inverse().t;
  views.scene.objects.push_back(before);
  EvaluateTogether(views.context, &views.scene);
  EXPECT_GT(views.scene.objects[0].total.hidden_by_others, 0.0);
  EXPECT_EQ(views.scene.objects[1].total.hidden_by_others, 0.0);
  EXPECT_LT(views.scene.objects[0].total.visible, alone.total.visible);
  EXPECT_GT(views.scene.objects[0].total.Precision(), 0.9);
}

TEST(MakeResult, OneViewIsNotRefusedForParallax) {
  OneObjectViews views(LBracket(), 1, 0.1, 0.0);
  views.Place({});
  EXPECT_EQ(LargestParallax(views.context, views.scene), 0.0);
  EXPECT_EQ(
      MakeResult(
          views.context, views.scene, {}, BestCompeting(views.context, views.scene, {}), {}, true)
          .state,
      RecognitionState::kRecognized);
  views.scene.objects.clear();
  EXPECT_EQ(
      MakeResult(
          views.context, views.scene, {}, BestCompeting(views.context, views.scene, {}), {}, true)
          .state,
      RecognitionState::kNothingFound);
}

}  // namespace
}  // namespace horopter
