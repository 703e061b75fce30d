#include "server/vision/recognition/interpretation/decision.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/one_object_views.h"

namespace horopter {
namespace {

TEST(ReasonToDoubt, IsAFocalLengthThatLeavesItsPrior) {
  OneObjectViews views(LBracket(), 3, 0.3, 0.0);
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
  OneObjectViews views(LBracket(), 3, 0.3, 0.0);
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
  OneObjectViews views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  const double few = SceneProbability(views.context, views.scene);
  const std::vector<std::shared_ptr<const PreparedObject>> many(2000, views.objects[0]);
  views.context.objects = many;
  const double among_many = SceneProbability(views.context, views.scene);
  EXPECT_LT(among_many, few);
  EXPECT_NEAR(among_many / (1 - among_many) * 100, few / (1 - few), 1e-6 * few / (1 - few));
}

TEST(SceneProbability, AnObjectThatLeadsThoseInItsPlacePaysNothingForTheirNumber) {
  OneObjectViews views(LBracket(), 3, 0.3, 0.0);
  views.Place({});
  const double few = SceneProbability(views.context, views.scene);
  const std::vector<std::shared_ptr<const PreparedObject>> many(2000, views.objects[0]);
  views.context.objects = many;
  PlacedObject other = views.scene.objects[0];
  other.object = 1;
  const auto probability = [&](double score) {
    other.score = score;
    const std::vector<double> second = BestCompeting(views.context, views.scene, {&other, 1});
    EXPECT_EQ(second.size(), 1u);
    return SceneProbability(views.context, views.scene, second);
  };
  EXPECT_NEAR(probability(0.0), few, 1e-12);
  const double accepted = views.scene.objects[0].score;
  EXPECT_LT(probability(accepted - 0.15), few);
  EXPECT_LT(probability(accepted - 0.05), probability(accepted - 0.15));
  // The same elsewhere, or another pose of the object itself, is no alternative.
  other.scene_from_object.t.x() += 1.0;
  EXPECT_NEAR(probability(accepted - 0.05), few, 1e-12);
  other.scene_from_object = {};
  other.object = 0;
  EXPECT_NEAR(probability(accepted - 0.05), few, 1e-12);
}

TEST(DropChanceObjects, LeavesOutWhatSomeOfManyObjectsFitByChance) {
  OneObjectViews views(LBracket(), 3, 0.3, 0.0);
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
TEST(DropUnlikelyObjects, LeavesOutBluntOnesAndRenumbersTheAlternatives) {
  const auto placed = [](double score, double sharpness) {
    PlacedObject p;
    p.score = score;
    p.total.supported = 1000.0;
    p.total.sharp = 1000.0 * sharpness;
    return p;
  };
  SceneModel scene;
  scene.objects = {placed(0.8, 0.8), placed(0.62, 0.2), placed(0.56, 0.7)};
  std::vector<Alternative> alternatives(3);
  for (int k = 0; k < 3; ++k) alternatives[k].accepted = k;
  DropUnlikelyObjects({}, &scene, &alternatives);
  ASSERT_EQ(scene.objects.size(), 2u);
  EXPECT_EQ(scene.objects[1].score, 0.56);
  ASSERT_EQ(alternatives.size(), 2u);
  EXPECT_EQ(alternatives[0].accepted, 0);
  EXPECT_EQ(alternatives[1].accepted, 1);
  scene.objects = {placed(0.62, 0.1), placed(0.6, 0.1)};
  alternatives.clear();
  DropUnlikelyObjects({}, &scene, &alternatives);
  EXPECT_EQ(scene.objects.size(), 1u);  // whether the scene is one is asked elsewhere
}

TEST(ObjectProbability, GrowsWithSupportSharpnessAndTexture) {
  PlacedObject p;
  p.score = 0.6;
  p.total.supported = 1000.0;
  p.total.sharp = 600.0;
  const double plain = ObjectProbability(p);
  PlacedObject better = p;
  better.score = 0.7;
  EXPECT_GT(ObjectProbability(better), plain);
  better = p;
  better.total.sharp = 700.0;
  EXPECT_GT(ObjectProbability(better), plain);
  better = p;
  better.texture = 2.0;
  EXPECT_GT(ObjectProbability(better), plain);
  better.texture = -1.0;  // what hides a right part says nothing against it here
  EXPECT_EQ(ObjectProbability(better), plain);
}

}  // namespace
}  // namespace horopter
