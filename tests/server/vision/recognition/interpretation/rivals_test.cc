#include "server/vision/recognition/interpretation/rivals.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>

#include "server/vision/recognition/interpretation/answer.h"
#include "server/vision/recognition/interpretation/decision.h"
#include "tests/server/vision/recognition/aspects/solid_meshes.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

ObjectModel Box(double x, double y, double z) {
  return Prism("box", {{0, 0}, {x, 0}, {x, y}, {0, y}}, z);
}

Rigid3 Turn(const PreparedObject& object, double angle, const Eigen::Vector3d& axis) {
  const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
  return {R, object.center - R * object.center};
}

// Views of one object in the origin, `step` radians apart, with exact edges.
struct Views {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<ImageFeatures> features;
  MatchingResult matching;
  JointContext context;
  SceneModel scene;

  Views(ObjectModel model, int views, double step, double noise_px) {
    objects.push_back(PrepareObject(std::move(model)).value());
    context.objects = objects;
    context.matching = &matching;
    std::mt19937 rng(21);
    features.resize(views);
    for (int v = 0; v < views; ++v) {
      const double a = 0.3 + step * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 900);
      const Rigid3 camera_from_scene =
          LookAt({0.6 * std::sin(a), -0.6 * std::cos(a), 0.45}, {0.05, 0.05, 0.04});
      features[v].width = 640;
      features[v].height = 480;
      AddSyntheticFeatures(*objects[0], camera, camera_from_scene, noise_px, &rng, &features[v]);
      scene.views.push_back(RecognizedView{camera, camera_from_scene});
    }
    for (const ImageFeatures& f : features) {
      context.views.push_back(BuildViewEvidence(f));
      context.start_cameras.push_back(CenteredCamera(640, 480, 900));
      context.focal_log_sigma.push_back(0.05);
    }
    matching.component.assign(views, -1);
  }

  void Place(const Rigid3& pose) {
    PlacedObject p;
    p.object = 0;
    p.scene_from_object = pose;
    VerifyScratch scratch;
    EvaluatePlacement(context, scene.views, {}, &scratch, &p);
    scene.objects = {p};
    scene.gain = p.gain;
  }
};

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
    Views views(Box(0.1, 0.112, 0.06), 4, 0.4, noise_px);
    const PreparedObject& box = *views.objects[0];
    views.Place(Turn(box, std::numbers::pi / 2, Eigen::Vector3d::UnitZ()));
    const double wrong = views.scene.objects[0].score;
    const std::vector<Rival> rivals = ContestObjects(views.context, {}, {}, &views.scene);
    EXPECT_FALSE(rivals.empty());
    EXPECT_GT(views.scene.objects[0].score, wrong);
    // Right up to the half turn, which is a symmetry that nobody declared.
    EXPECT_GT(std::abs(views.scene.objects[0].scene_from_object.R(0, 0)), 0.98);
    for (const Rival& r : rivals) EXPECT_EQ(r.accepted, 0);
  }
}

TEST(MakeResult, SaysWhenAnotherPoseOfTheObjectScoresAsWell) {
  Views views(Box(0.1, 0.104, 0.06), 4, 0.4, 0.0);
  views.Place({});
  Rival rival{0, views.scene.objects[0], views.scene.objects[0].score - 0.08, 0.0};
  const auto state = [&](bool trusted) {
    return MakeResult(views.context,
                      views.scene,
                      {},
                      RunnersUp(views.context, views.scene, {}, {&rival, 1}),
                      {&rival, 1},
                      trusted);
  };
  EXPECT_EQ(state(true).state, RecognitionState::kRecognized);
  const RecognitionResult loose = state(false);  // the cameras may have adapted to either pose
  EXPECT_EQ(loose.state, RecognitionState::kAmbiguous);
  ASSERT_EQ(loose.objects.size(), 1u);
  EXPECT_EQ(loose.objects[0].alternatives, std::vector<int>{0});
  EXPECT_FALSE(loose.detail.empty());
  rival.score = views.scene.objects[0].score - 0.01;
  EXPECT_EQ(state(true).state, RecognitionState::kAmbiguous);
  rival.score = 0.0;
  EXPECT_EQ(state(false).state, RecognitionState::kRecognized);
}

TEST(MakeResult, AnswersNothingWithoutParallax) {
  for (const double step : {0.001, 0.004, 0.05, 0.3}) {
    Views views(LBracket(), 4, step, 0.0);
    views.Place({});
    const double parallax = LargestParallax(views.context, views.scene);
    EXPECT_GT(parallax, step);  // 3 steps about a point below the cameras
    EXPECT_LT(parallax, 3.0 * step + 1e-6);
    const RecognitionResult r = MakeResult(
        views.context, views.scene, {}, RunnersUp(views.context, views.scene, {}), {}, true);
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

TEST(ReasonToDoubt, IsAFocalLengthThatLeavesItsPrior) {
  Views views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  EXPECT_EQ(ReasonToDoubt(views.context, views.scene), "");
  views.scene.views[1]->camera.focal_px *= std::exp(3.5 * 0.05);
  EXPECT_EQ(ReasonToDoubt(views.context, views.scene), "");
  views.scene.views[1]->camera.focal_px *= std::exp(1.0 * 0.05);
  EXPECT_NE(ReasonToDoubt(views.context, views.scene), "");
  views.scene.views[1].reset();
  EXPECT_EQ(ReasonToDoubt(views.context, views.scene), "");
}

TEST(ReasonToDoubt, IsSupportThatChanceMayGive) {
  Views views(LBracket(), 3, 0.3, 0.0);
  EXPECT_EQ(ReasonToDoubt(views.context, views.scene), "");  // nothing was found
  views.Place({});
  PlacedObject& object = views.scene.objects[0];
  const PlacedObject good = object;
  EXPECT_GT(good.total.Sharpness(), 0.9);  // edges are exact
  EXPECT_GT(SceneProbability(views.context, views.scene), 0.9);
  object.score = 0.65;
  EXPECT_NE(ReasonToDoubt(views.context, views.scene), "");
  // Several that fit so well in the same cameras are no chance.
  views.scene.objects.assign(3, object);
  EXPECT_EQ(ReasonToDoubt(views.context, views.scene), "");
  views.scene.objects = {good};
  views.scene.objects[0].total.sharp = 0.3 * good.total.supported;
  EXPECT_NE(ReasonToDoubt(views.context, views.scene), "");
}

TEST(SceneProbability, FallsWithTheNumberOfObjectsTried) {
  Views views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  const double few = SceneProbability(views.context, views.scene);
  const std::vector<std::shared_ptr<const PreparedObject>> many(2000, views.objects[0]);
  views.context.objects = many;
  const double among_many = SceneProbability(views.context, views.scene);
  EXPECT_LT(among_many, few);
  EXPECT_NEAR(among_many / (1 - among_many) * 100, few / (1 - few), 1e-6 * few / (1 - few));
}

TEST(SceneProbability, AnObjectThatLeadsThoseInItsPlacePaysNothingForTheirNumber) {
  Views views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  const double few = SceneProbability(views.context, views.scene);
  const std::vector<std::shared_ptr<const PreparedObject>> many(2000, views.objects[0]);
  views.context.objects = many;
  PlacedObject other = views.scene.objects[0];
  other.object = 1;
  const auto probability = [&](double score) {
    other.score = score;
    const std::vector<double> second = RunnersUp(views.context, views.scene, {&other, 1});
    EXPECT_EQ(second.size(), 1u);
    return SceneProbability(views.context, views.scene, second);
  };
  EXPECT_NEAR(probability(0.0), few, 1e-12);
  const double held = views.scene.objects[0].score;
  EXPECT_LT(probability(held - 0.15), few);
  EXPECT_LT(probability(held - 0.05), probability(held - 0.15));
  // The same elsewhere, or another pose of the object itself, is no rival.
  other.scene_from_object.t.x() += 1.0;
  EXPECT_NEAR(probability(held - 0.05), few, 1e-12);
  other.scene_from_object = {};
  other.object = 0;
  EXPECT_NEAR(probability(held - 0.05), few, 1e-12);
}

TEST(DropChanceObjects, LeavesOutWhatSomeOfManyObjectsFitByChance) {
  Views views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  PlacedObject weak = views.scene.objects[0];
  weak.object = 1;
  weak.score = 0.6;
  weak.total.sharp = 0.6 * weak.total.supported;
  weak.scene_from_object.t.x() += 1.0;
  views.scene.objects.push_back(weak);
  for (const int catalog : {20, 2000}) {
    const std::vector<std::shared_ptr<const PreparedObject>> objects(catalog, views.objects[0]);
    views.context.objects = objects;
    SceneModel scene = views.scene;
    DropChanceObjects(views.context, {}, &scene);
    EXPECT_EQ(scene.objects.size(), catalog == 20 ? 2u : 1u);
    EXPECT_EQ(scene.objects[0].object, 0);
  }
}

// Support alone does not make an object likely: a part that shares edges with what stands there
// fits bluntly.
TEST(DropUnlikelyObjects, LeavesOutBluntOnesAndRenumbersTheRivals) {
  const auto placed = [](double score, double sharpness) {
    PlacedObject p;
    p.score = score;
    p.total.supported = 1000.0;
    p.total.sharp = 1000.0 * sharpness;
    return p;
  };
  SceneModel scene;
  scene.objects = {placed(0.8, 0.8), placed(0.62, 0.2), placed(0.56, 0.7)};
  std::vector<Rival> rivals(3);
  for (int k = 0; k < 3; ++k) rivals[k].accepted = k;
  DropUnlikelyObjects(&scene, &rivals);
  ASSERT_EQ(scene.objects.size(), 2u);
  EXPECT_EQ(scene.objects[1].score, 0.56);
  ASSERT_EQ(rivals.size(), 2u);
  EXPECT_EQ(rivals[0].accepted, 0);
  EXPECT_EQ(rivals[1].accepted, 1);
  scene.objects = {placed(0.62, 0.1), placed(0.6, 0.1)};
  rivals.clear();
  DropUnlikelyObjects(&scene, &rivals);
  EXPECT_EQ(scene.objects.size(), 1u);  // whether the scene is one is asked elsewhere
}

TEST(EvaluateTogether, WhatOneObjectHidesIsNoEvidenceAgainstAnother) {
  Views views(LBracket(), 3, 0.3, 0.0);
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
  Views views(LBracket(), 1, 0.1, 0.0);
  views.Place({});
  EXPECT_EQ(LargestParallax(views.context, views.scene), 0.0);
  EXPECT_EQ(MakeResult(
                views.context, views.scene, {}, RunnersUp(views.context, views.scene, {}), {}, true)
                .state,
            RecognitionState::kRecognized);
  views.scene.objects.clear();
  EXPECT_EQ(MakeResult(
                views.context, views.scene, {}, RunnersUp(views.context, views.scene, {}), {}, true)
                .state,
            RecognitionState::kNothingFound);
}

}  // namespace
}  // namespace horopter
